"""Episodes as LeRobotDataset v3.0: rows by pyarrow, videos by PyAV, pictures by Pillow, lenses read back."""

import io
import json

import av
import numpy as np
import pytest
from PIL import Image
from pyarrow import parquet
from scipy.spatial.transform import Rotation

import omniscv
from omniscv import cameras, dataset
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError, ExistingDatasetError
from omniscv.geometry import Pose

WRIST = cameras.create("fisheye-equidistant", 64, 64, fov_deg=190)
TABLE = cameras.create("equirectangular", 96, 48)
STEPS = (3, 4)
FPS = 20
STATE = np.array([0.1, 1 / 3, -2.5e-3], np.float32)


def pose_of(episode, step):
    return Pose.from_angles((0.1 * episode, 0.02 * step, 1.4), 10 * step, 3 * episode)


def made(out, rig, **options):
    """A dataset of two episodes, of 3 and 4 steps, with states and actions."""
    with (
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(out, rig, fps=FPS, task="look around", face_size=32, **options) as episodes,
    ):
        for episode, steps in enumerate(STEPS):
            for step in range(steps):
                pose = pose_of(episode, step)
                poses = pose if isinstance(rig, Rig) else dict.fromkeys(rig, pose)
                episodes.add(source, poses, state=STATE * (step + 1), action=[step, episode])
            episodes.end()
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The dataset of two cameras, each for itself, and its export."""
    folder = made(tmp_path_factory.mktemp("robot") / "robot", {"wrist": WRIST, "table": TABLE})
    dataset.export(folder, "lerobot")
    return folder


@pytest.fixture(scope="module")
def info(folder):
    return json.loads((folder / "exports/lerobot/meta/info.json").read_text())


def rows(folder, episode):
    return parquet.read_table(folder / f"exports/lerobot/data/chunk-000/file-{episode:03d}.parquet")


def frames_of(folder, name):
    frames = [frame for frame in dataset.open(folder) if frame.camera_name == name]
    return sorted(frames, key=lambda frame: frame.key)


def test_episodes_are_a_sound_dataset_whose_times_increase(folder, tmp_path):
    """Programs of trajectories take it, too: a camera has one pose at a time."""
    assert dataset.check(folder, deep=True) == []
    for name in ("wrist", "table"):
        times = [frame.time for frame in frames_of(folder, name)]
        np.testing.assert_allclose(times, np.arange(sum(STEPS)) / FPS, atol=1e-9)
    assert dataset.export(folder, "poses", tmp_path / "poses")


def test_rows_have_the_numbers_of_their_frames(folder):
    first = 0
    for episode, steps in enumerate(STEPS):
        table = rows(folder, episode).to_pydict()
        assert table["frame_index"] == list(range(steps))
        assert table["episode_index"] == [episode] * steps
        assert table["index"] == list(range(first, first + steps))
        np.testing.assert_array_equal(table["timestamp"], np.float32(np.arange(steps) / FPS))
        first += steps


def test_states_and_actions_are_those_that_were_given(folder):
    table = rows(folder, 1)
    states = np.stack(table["observation.state"].to_numpy(zero_copy_only=False))
    assert states.dtype == np.float32
    np.testing.assert_array_equal(states, [STATE * (step + 1) for step in range(STEPS[1])])
    assert table["action"].to_pylist() == [[step, 1] for step in range(STEPS[1])]


@pytest.mark.parametrize("name", ["wrist", "table"])
def test_each_camera_has_its_pose(folder, name):
    for episode, steps in enumerate(STEPS):
        poses = np.array(rows(folder, episode)[f"observation.pose.{name}"].to_pylist())
        for step in range(steps):
            pose = pose_of(episode, step)
            np.testing.assert_allclose(poses[step, :3], pose.position, atol=1e-12)
            rotation = Rotation.from_quat(poses[step, 3:]).as_matrix()
            np.testing.assert_allclose(rotation, pose.rotation, atol=1e-12)


@pytest.mark.parametrize("name", ["wrist", "table"])
def test_videos_show_the_colours(folder, info, name):
    """Within the loss of the codec: chroma of 2 x 2 px, which small pictures with hard edges show most."""
    path = info["video_path"].format(video_key=f"observation.images.{name}", chunk_index=0, file_index=1)
    frames = [frame for frame in frames_of(folder, name) if frame.place == "episode-0001"]
    with av.open(str(folder / "exports/lerobot" / path)) as video:
        pictures = list(video.decode(video=0))
    assert len(pictures) == len(frames) == STEPS[1]
    for step, (picture, frame) in enumerate(zip(pictures, frames, strict=True)):
        assert picture.time == pytest.approx(step / FPS, abs=1e-4)
        shown = picture.to_ndarray(format="rgb24").astype(int)
        off = np.abs(shown - frame.layer("lit"))[frame.camera.valid()]
        assert off.mean() < 6
        others = [np.abs(shown - other.layer("lit")).mean() for other in frames]
        assert int(np.argmin(others)) == step


@pytest.mark.parametrize("name", ["wrist", "table"])
def test_depth_is_within_half_a_millimetre_of_the_truth_and_labels_are_equal(folder, name):
    frames = [frame for frame in frames_of(folder, name) if frame.place == "episode-0000"]
    table = rows(folder, 0)
    for kind in ("depth", "labels"):
        cells = table[f"observation.images.{name}_{kind}"].to_pylist()
        for cell, frame in zip(cells, frames, strict=True):
            values = np.array(Image.open(io.BytesIO(cell["bytes"]))).astype(float)
            truth = frame.layer(kind)
            if kind == "labels":
                assert np.array_equal(values, truth)
                continue
            seen = np.isfinite(truth) & frame.camera.valid()
            assert seen.mean() > 0.5
            assert np.abs(values / 1000 - truth)[seen].max() <= 0.0005 + 1e-6  # float32 beside a half
            assert (values[~np.isfinite(truth)] == 0).all()


@pytest.mark.parametrize(("name", "camera"), [("wrist", WRIST), ("table", TABLE)])
def test_a_lens_read_back_projects_as_its_camera_does(folder, info, name, camera):
    points = np.random.default_rng(3).normal(size=(1000, 3))
    described = json.loads((folder / f"exports/lerobot/calibration/{name}.json").read_text())
    for description in (info["features"][f"observation.images.{name}"]["info"]["camera"], described):
        pixels, valid = cameras.from_dict(description).project(points)
        expected, expected_valid = camera.project(points)
        np.testing.assert_array_equal(valid, expected_valid)
        np.testing.assert_allclose(pixels[valid], expected[valid], atol=1e-6)


def test_meta_files_say_where_episodes_are(folder, info):
    episodes = parquet.read_table(
        folder / "exports/lerobot/meta/episodes/chunk-000/file-000.parquet"
    ).to_pylist()
    assert [row["length"] for row in episodes] == list(STEPS)
    assert [row["dataset_from_index"] for row in episodes] == [0, STEPS[0]]
    assert [row["dataset_to_index"] for row in episodes] == [STEPS[0], sum(STEPS)]
    assert all(row["tasks"] == ["look around"] for row in episodes)
    assert [row["videos/observation.images.wrist/file_index"] for row in episodes] == [0, 1]
    assert episodes[1]["videos/observation.images.wrist/to_timestamp"] == pytest.approx(STEPS[1] / FPS)
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", FPS, sum(STEPS))
    tasks = parquet.read_table(folder / "exports/lerobot/meta/tasks.parquet")
    assert tasks["__index_level_0__"].to_pylist() == ["look around"]


def test_statistics_are_those_of_the_columns(folder):
    statistics = json.loads((folder / "exports/lerobot/meta/stats.json").read_text())
    states = []
    for episode in range(len(STEPS)):
        states += rows(folder, episode)["observation.state"].to_pylist()
    values = np.array(states, np.float32).astype(float)
    for name, expected in (
        ("min", values.min(0)),
        ("max", values.max(0)),
        ("mean", values.mean(0)),
        ("std", values.std(0)),
    ):
        np.testing.assert_allclose(statistics["observation.state"][name], expected, rtol=1e-12)
    assert statistics["observation.state"]["count"] == [sum(STEPS)]
    assert np.shape(statistics["observation.images.wrist"]["mean"]) == (3, 1, 1)


def test_columns_are_those_of_the_features(folder, info):
    columns = set(rows(folder, 0).column_names)
    described = {key for key, feature in info["features"].items() if feature["dtype"] != "video"}
    assert columns == described
    assert info["features"]["observation.images.wrist_depth"]["info"]["is_depth_map"] is True
    assert info["features"]["observation.images.wrist_depth"]["info"]["depth_unit"] == "mm"


def test_without_states_the_pose_of_the_rig_is_the_state(tmp_path):
    rig = Rig({"left": RigCamera(WRIST), "right": RigCamera.turned(WRIST, position=(0.2, 0, 0))})
    with (
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(tmp_path / "rig", rig, fps=FPS, modes=("lit",), face_size=32) as episodes,
    ):
        for step in range(2):
            episodes.add(source, pose_of(0, step))
        episodes.end()
    dataset.export(tmp_path / "rig", "lerobot")
    table = rows(tmp_path / "rig", 0)
    assert "action" not in table.column_names
    assert table["observation.state"].to_pylist() == table["observation.pose.left"].to_pylist()
    right = np.array(table["observation.pose.right"].to_pylist())
    left = np.array(table["observation.pose.left"].to_pylist())
    assert np.linalg.norm(right[:, :3] - left[:, :3], axis=1) == pytest.approx([0.2, 0.2])


def test_vectors_of_one_number_are_numbers(tmp_path):
    """Readers of the format take a column of shape [1] as one of numbers."""
    with (
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(tmp_path / "one", TABLE, fps=FPS, modes=("lit",), face_size=32) as episodes,
    ):
        for step in range(2):
            episodes.add(source, pose_of(0, step), action=[0.5 * step])
        episodes.end()
    dataset.export(tmp_path / "one", "lerobot")
    assert rows(tmp_path / "one", 0)["action"].to_pylist() == [0, 0.5]


def test_episodes_begin_in_a_folder_of_their_own(folder):
    with (
        pytest.raises(
            ExistingDatasetError, match="got a dataset; remove it, or begin the episodes elsewhere"
        ),
        dataset.episodes(folder, TABLE),
    ):
        pass


def test_an_episode_that_is_not_ended_is_refused(tmp_path):
    with (
        pytest.raises(ArgumentError, match=r"expected end\(\) after the last step"),
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(tmp_path / "open", TABLE, modes=("lit",), face_size=32) as episodes,
    ):
        episodes.add(source, pose_of(0, 0))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"state": [np.nan]}, "state: expected a vector of finite numbers"),
        ({"action": "left"}, "action: expected a vector of finite numbers"),
        ({"pose": {"other": pose_of(0, 0)}}, "pose: expected one of each of camera, got other"),
    ],
    ids=["nan", "text", "another camera"],
)
def test_a_wrong_step_is_refused(tmp_path, change, says):
    step = {"pose": pose_of(0, 0), **change}
    with (
        pytest.raises(ArgumentError, match=says),
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(tmp_path / "wrong", TABLE, modes=("lit",), face_size=32) as episodes,
    ):
        episodes.add(source, **step)


def test_pictures_of_an_odd_size_are_refused(tmp_path):
    odd = cameras.create("equirectangular", 66, 33)
    with (
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(tmp_path / "odd", odd, modes=("lit",), face_size=32) as episodes,
    ):
        episodes.add(source, pose_of(0, 0))
        episodes.end()
    with pytest.raises(
        ArgumentError, match=r"expected an even width and height, as H.264 needs, got 66 x 33"
    ):
        dataset.export(tmp_path / "odd", "lerobot")
