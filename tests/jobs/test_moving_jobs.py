"""Jobs of worlds that move: each image is of the world at its own time, judged by the scene at that time."""

from dataclasses import replace

import numpy as np
import pytest
from support.datasets import first_of

import mock_server
import omniscv
from mock_server.scene_file import turned
from omniscv import Pose, RenderOptions
from omniscv.cameras import create
from omniscv.compose.files import read
from omniscv.errors import ArgumentError
from omniscv.geometry.instant import Motion, object_pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.geometry.trajectory_files import write_tum
from omniscv.job import Exposure, load
from omniscv.make import capture, costs, instants, run
from omniscv.make.instants import frames_by_instant, instants_for, motion_px
from omniscv.make.source import opened
from omniscv.sources.scene import SceneSource

WORKSHOP = mock_server.load_scene("workshop")
PANORAMA = "{model: equirectangular, width: 48, height: 24}"
SLIDE = "[{time: 0, position: [-2, -0.6, 0.85]}, {time: 2, position: [-1.2, 0.8, 0.85], yaw_deg: 60}]"

JOB = """
source: scene://workshop
cameras: {{pano: {camera}}}
poses: {poses}
modes: [lit, object_mask, depth]
face_size: 32
{more}
"""


def job_of(folder, more="", camera=PANORAMA, poses="[{position: [0, 0, 1.2]}]"):
    path = folder / "job.yaml"
    path.write_text(JOB.format(camera=camera, more=more, poses=poses), encoding="utf-8")
    return load(path)


def slid(time):
    """Where SLIDE has the cabinet, written out: a straight way, and an even turn about the vertical."""
    share = min(max(time / 2, 0), 1)
    return {"Cabinet": (turned(60 * share), np.array([-2 + 0.8 * share, -0.6 + 1.4 * share, 0.85]))}


def rendered(job, time, camera=None, pose=None, poses=None):
    """An image of the job's kind, of the scene as it is at a time."""
    scene = WORKSHOP.at(time, slid(time) if poses is None else poses)
    with SceneSource(scene) as source:
        renderer = omniscv.Renderer(source)
        return renderer.render(camera or job.cameras["pano"], pose or job.poses[0], job.modes, job.options)


def images_of(job):
    written = run(job)
    paths = {path.name: path for path in written}
    stems = sorted(name.removesuffix(".labels.png") for name in paths if name.endswith(".labels.png"))
    kinds = {"lit": "png", "labels": "png", "depth": "exr"}
    return {s: {kind: read(paths[f"{s}.{kind}.{end}"], kind) for kind, end in kinds.items()} for s in stems}


def assert_same(layers, image):
    for name, layer in layers.items():
        np.testing.assert_array_equal(layer, image[name], err_msg=name)


def test_each_image_is_of_the_scene_at_its_time(tmp_path):
    job = job_of(tmp_path, f"times: [0, 0.5, 1.25]\nmotions: {{Cabinet: {SLIDE}}}")
    found = images_of(job)
    assert list(found) == ["pano-0", "pano-1", "pano-2"]
    for time, layers in zip((0, 0.5, 1.25), found.values(), strict=True):
        assert_same(layers, rendered(job, time))
    assert (found["pano-0"]["labels"] != found["pano-2"]["labels"]).any()


def test_a_world_with_a_clock_of_its_own_is_at_the_poses_times(tmp_path):
    """Only where 'times' is given: the poses' own times alone are those of a trajectory in a still world."""
    poses = "[{position: [0, 0, 1.2], time: 1.25}]"
    job = job_of(tmp_path)
    still = replace(job, times_ns=(1_250_000_000,))
    moving = job_of(tmp_path, "times: poses", poses=poses)
    assert (still.moves, moving.moves) == (False, True)
    assert_same(images_of(still)["pano"], rendered(job, 0, poses={}))
    assert_same(images_of(moving)["pano"], rendered(job, 1.25, poses={}))


def test_motions_of_files_and_splines(tmp_path):
    """A file in the form of TUM holds the object's own rotation; a spline goes where the waypoints do."""
    known = Trajectory.timed((object_pose((1, 2, 0.5), 10), object_pose((2, 2, 0.5), 50)), (0.0, 1.0))
    (tmp_path / "crate.tum").write_text(write_tum(known), encoding="utf-8")
    motions = f"{{Crate: crate.tum, Cabinet: {{spline: crate.tum}}, Lamp: {{spline: {SLIDE}}}}}"
    more = f"times: [0, 1]\nmotions: {motions}"
    job = job_of(tmp_path, more)
    assert [motion.curve for motion in job.motions.values()] == ["linear", "spline", "spline"]
    for shared, wanted in zip(frames_by_instant(job), known, strict=True):
        for name in ("Crate", "Cabinet"):
            pose = shared.instant.poses[name]
            np.testing.assert_allclose(pose.rotation, wanted.rotation, atol=1e-9)
            np.testing.assert_allclose(pose.position, wanted.position, atol=1e-12)


def test_times_of_poses(tmp_path):
    ranged = job_of(tmp_path, "times: {start: 1, rate: 4, count: 3}")
    assert (len(ranged), ranged.times_ns) == (3, (10**9, 1_250_000_000, 1_500_000_000))
    poses = "[{position: [0, 0, 1], time: 0}, {position: [2, 0, 1], time: 4}]"
    along = job_of(tmp_path, "times: [1, 3]", poses=poses)
    assert [pose.position[0] for pose in along.poses] == [0.5, 1.5]
    sampled = "{path: {waypoints: [[0, 0, 1], [1, 0, 1]], speed: 1, rate: 2}}"
    path = job_of(tmp_path, "times: poses", poses=sampled)
    assert path.times_ns == (0, 500_000_000, 10**9)
    assert [shared.instant.time for shared in frames_by_instant(path)] == [0.0, 0.5, 1.0]


def test_times_since_1970(tmp_path):
    """The world's clock starts with the first; lines of 30 microseconds keep their digits."""
    start = 1403636579.763555
    rows = [f"{start + i:.6f} {i} 0 1.2 0.5 -0.5 0.5 -0.5\n" for i in range(3)]
    (tmp_path / "path.tum").write_text("".join(rows))
    job = job_of(tmp_path, "times: {rate: 4}", poses="path.tum")
    assert len(job.poses) == 9
    assert job.times_ns[-1] - job.times_ns[0] == 2 * 10**9
    np.testing.assert_allclose([pose.position[0] for pose in job.poses], np.arange(9) / 4, atol=1e-6)
    assert [shared.instant.time for shared in frames_by_instant(job)][:3] == [0, 0.25, 0.5]
    frame = next(frames_by_instant(job)).frames[0]
    assert frame.time_ns == job.times_ns[0] == 1403636579763555000
    assert_same(images_of(first_of(job, 1))["pano"], rendered(job, 0, poses={}))
    moved = [job.path.at(job.times_ns[1] + i * 30_000).position[0] for i in range(100)]
    np.testing.assert_allclose(np.diff(moved), 3e-5, rtol=1e-9)


WRITTEN = {
    "1700000000.05": 1_700_000_000_050_000_000,
    "1700000000.123456789": 1_700_000_000_123_456_789,
    "0.1": 100_000_000,
}


@pytest.mark.parametrize("written", WRITTEN)
@pytest.mark.parametrize("door", ["list", "JSON list", "waypoint", "start", "epoch", "CSV", "TUM"])
def test_times_are_the_nanoseconds_that_are_written(door, written, tmp_path):
    place = "[{position: [0, 0, 1]}]"
    if door == "list":
        job = job_of(tmp_path, f"times: [{written}]", poses=place)
    elif door == "JSON list":
        job = job_of(tmp_path, f'"times": [{written}]', poses='[{"position": [0, 0, 1]}]')
    elif door == "waypoint":
        job = job_of(tmp_path, "times: poses", poses=f"[{{position: [0, 0, 1], time: {written}}}]")
    elif door == "start":
        job = job_of(tmp_path, f"times: {{start: {written}, rate: 3, count: 1}}", poses=place)
    elif door == "epoch":
        job = job_of(tmp_path, f"times: [0]\nepoch: {written}", poses=place)
    else:
        text = f"time,x,y,z\n{written},0,0,1\n" if door == "CSV" else f"{written} 0 0 1 0 0 0 1\n"
        (tmp_path / "path.txt").write_text(text)
        job = job_of(tmp_path, "times: poses", poses="path.txt")
    assert job.times_ns == (WRITTEN[written],)


@pytest.mark.parametrize("written", ["1e-999999999", "'1e-999999999'", "0.0000000000000000000001e-99999"])
def test_times_of_any_exponent_are_read_at_once(written, tmp_path):
    assert job_of(tmp_path, f"times: [{written}]", poses="[{position: [0, 0, 1]}]").times_ns == (0,)


def test_a_rate_makes_times_without_drift(tmp_path):
    job = job_of(
        tmp_path, "times: {start: 1700000000.05, rate: 0.3, count: 4}", poses="[{position: [0, 0, 1]}]"
    )
    start = 1_700_000_000_050_000_000
    assert job.times_ns == (start, start + 3333333333, start + 6666666667, start + 10**10)


def test_a_late_camera_of_a_rig_sees_the_world_at_its_own_time(tmp_path):
    rig = f"""rig: {{cameras: {{left: {{camera: {PANORAMA}}},
      right: {{camera: {PANORAMA}, position: [0.1, 0, 0], time_offset: 0.25}}}}}}"""
    poses = ", ".join(f"{{position: [0, 0, 1.2], time: {time}}}" for time in range(3))
    more = f"times: poses\nmotions: {{Cabinet: {SLIDE}}}\n{rig}"
    job = job_of(tmp_path, more, poses=f"[{poses}]")
    assert "1 of 3 are left out: their images, of 0.25 s, would" in job.assumed
    groups = list(frames_by_instant(job))
    times = {frame.key: (of.instant.time, frame.time) for of in groups for frame in of.frames}
    assert times["right-0"] == times["right-0"][:1] * 2 == (0.25, 0.25)
    assert times["pano-1"] == times["left-1"] == (1.0, 1.0)
    found = images_of(job)
    beside = Pose.from_angles((0, -0.1, 1.2))
    assert_same(found["right-0"], rendered(job, 0.25, job.cameras["right"], beside))
    assert_same(found["pano-1"], rendered(job, 1.0))


# -- exposures ---------------------------------------------------------------------------------------------


def test_colours_are_the_mean_of_an_exposure_and_the_truth_is_its_middle(tmp_path):
    exposed = f"times: [1]\nmotions: {{Cabinet: {SLIDE}}}\nexposure: {{seconds: 0.5, instants: 5}}"
    job = job_of(tmp_path, exposed)
    layers = images_of(job)["pano"]
    parts = [rendered(job, time) for time in (0.8, 0.9, 1.0, 1.1, 1.2)]
    mean = np.mean([part.lit.astype(int) for part in parts], axis=0)
    assert np.abs(layers["lit"] - mean).max() <= 0.5
    assert (layers["lit"] != parts[2].lit).any()
    for name in ("labels", "depth"):
        np.testing.assert_array_equal(layers[name], parts[2][name])


def test_a_camera_that_moves_is_exposed_along_its_way(tmp_path):
    """In a still world; a camera that rests, and one that stands still, show what a single instant does."""
    poses = "[{position: [0, 0, 1.2], time: 0}, {position: [1, 0, 1.2], time: 1}]"
    more = "exposure: {seconds: 0.3, instants: 3}"
    job = job_of(tmp_path, more, poses=poses)
    found = images_of(job)
    for i, start in enumerate((0.0, 1.0)):
        ways = [Pose.from_angles((start + offset, 0, 1.2)) for offset in (-0.1, 0, 0.1)]
        parts = [rendered(job, 0, pose=pose, poses={}) for pose in ways]
        mean = np.mean([part.lit.astype(int) for part in parts], axis=0)
        assert np.abs(found[f"pano-{i}"]["lit"] - mean).max() <= 0.5
        np.testing.assert_array_equal(found[f"pano-{i}"]["depth"], parts[1].depth)
    resting = images_of(replace(job, exposure=Exposure(0.3, 3, "rests")))
    assert_same(resting["pano-0"], rendered(job, 0, poses={}))


YARD = """
sky: [0.5, 0.6, 0.7]
room: {floor: [[-3, -3], [4, -3], [4, 3], [-3, 3]], height: 2.8}
objects:
  Slider:
    solids: [{box: [0.6, 0.5, 1.2], at: [2.5, -0.5, 0.9]}]
    moving: {kind: steady, velocity: [0, 4, 0]}
  Spinner:
    solids: [{box: [1.2, 0.15, 0.8], at: [2.2, 1.2, 1.2]}]
    moving: {kind: steady, turn_deg: 720}
  Post: {solids: [{cylinder: [0.1, 2.8], at: [1.5, -1.5, 1.4]}]}
"""
ROLLING = (
    "{{model: rolling-shutter, width: 64, height: 48, readout: {}, base: {{model: pinhole, fov_deg: 90}}}}"
)
WAY = ", ".join(
    f"{{time: {t}, position: [{1.5 * t * t - 0.5}, {0.3 * np.sin(4 * t)}, 1.4], yaw_deg: {60 * t},"
    f" pitch_deg: {5 * np.sin(9 * t)}}}"
    for t in (0, 0.1, 0.2, 0.3)
)


def on_the_way(folder, more="", traces=0, readout=0.05, camera=ROLLING):
    (folder / "yard.yaml").write_text(YARD)
    job = job_of(folder, f"imu: {{}}\nepoch: 0\n{more}", camera.format(readout), f"[{WAY}]")
    job = replace(job, source=f"scene://{folder}/yard.yaml?traces={traces}", modes=("object_mask", "depth"))
    return replace(job, options=RenderOptions(face_size=64))


def image_of(job, i):
    with opened(job) as (job, source):
        shared = list(frames_by_instant(job))[i]
        return job, shared, next(instants.images_of(omniscv.Renderer(source), shared, job))


@pytest.mark.parametrize(
    ("more", "traces", "counts"),
    [
        ("", 0, {1}),
        ("times: poses\nexposure: {instants: 9}", 0, {9}),
        ("times: poses\nexposure: {instants: 17}", 1, {17}),
        ("times: poses\nexposure: {instants: auto}", 1, range(15, 60)),
    ],
)
def test_each_line_is_the_path_and_the_world_at_its_time(tmp_path, more, traces, counts):
    """Each row is traced from the spline's pose at its time, in the scene at its time: what is wrong is
    marked, and depth is within its bound."""
    job, shared, image = image_of(on_the_way(tmp_path, more, traces), 1)
    assert len(shared.captured) in counts
    wrong, marked = judged(tmp_path, (job, shared, image), job.cameras["pano"].base.unproject().directions)
    # Labels are marked where depth may be off by more than 1 %, too: in an exposure a quarter of them.
    assert wrong.mean() < 0.015 < marked.mean() < 0.27 or traces


@pytest.mark.parametrize("traces", [0, 1])
def test_each_column_of_a_push_broom_is_the_path_at_its_time(tmp_path, traces):
    line = "{{model: push-broom, width: 64, height: 48, readout: {}}}"
    made = image_of(on_the_way(tmp_path, "", traces, 0.25, line), 0)
    down = (np.arange(0.5, 48) - 24) / 24
    ahead = np.stack([0 * down, down, 1 + 0 * down], axis=-1) / np.hypot(1, down)[:, None]
    wrong, marked = judged(tmp_path, made, np.stack([ahead] * 64, axis=1))
    assert wrong.mean() < 0.015 < marked.mean() < 0.22 or traces
    with pytest.raises(ArgumentError, match="pano: expected timed poses, along which it moves"):
        job_of(tmp_path, "", line.format(0.2))


def judged(folder, made, directions):
    """Which pixels are wrong, and which are marked, by rays (H, W, 3) of a camera whose rows, or columns of a
    push-broom, are read one after the other."""
    job = made[0]
    (frame, *_) = made[1].frames
    image = made[2]
    scene = mock_server.load_scene(folder / "yard.yaml")
    axis = int(job.cameras["pano"].name == "push-broom")
    wrong, beyond = np.zeros((2, 48, 64), bool)
    for k in range(n := wrong.shape[axis]):
        at = (slice(None),) * axis + (k,)
        at_ns = frame.time_ns + round(1e9 * job.cameras["pano"].readout * (k + 0.5) / n)
        pose = job.path.at(at_ns)
        now = scene.at(at_ns / 1e9 if job.moves else 0.0)
        hits = now.trace(pose.position, directions[at] @ pose.rotation.T)
        wrong[at] = image.labels[at] != hits.label
        beyond[at] = np.abs(image.depth[at] - hits.distance) > image["depth_error"][at] + 1e-6
    marked = image["label_edge"] | image["unsure"]
    assert (wrong & ~marked).mean() <= 0.0005
    assert beyond.mean() <= 0.0005
    return wrong, marked


def test_a_read_out_of_no_time_is_a_global_shutter_to_the_bit(tmp_path):
    rolling = on_the_way(tmp_path, "times: poses", readout=0)
    still = replace(rolling, cameras={"pano": rolling.cameras["pano"].base}, rig=None)
    layers = image_of(rolling, 1)[2].layers
    wanted = image_of(still, 1)[2].layers
    assert list(layers) == list(wanted)
    assert_same(layers, wanted)


def test_what_moves_a_camera_twice_or_cannot_be_told_is_refused(tmp_path):
    twice = ROLLING.format(0.05).replace("readout", "velocity: [1, 0, 0], readout")
    blurred = "exposure: {seconds: 0.1}\nsensor: {exposure_s: 0.2}"
    one = "{position: [0, 0, 1.2], time: 0}"
    for more, camera, poses, says in (
        ("", twice, WAY, "pano: expected no velocity or path, as the camera moves"),
        (
            "exposure: {seconds: 0.1}",
            PANORAMA,
            one,
            r"exposure\.seconds: expected several timed poses.* one",
        ),
        (blurred, PANORAMA, WAY, r"sensor\.exposure_s: expected none beside exposure\.seconds"),
    ):
        with pytest.raises(ArgumentError, match=says):
            job_of(tmp_path, more, camera, f"[{poses}]")
    assert job_of(tmp_path, blurred.replace("0.2", "0.1"), poses=f"[{WAY}]").sensor.exposure_s == 0.1
    job = on_the_way(tmp_path, "times: poses", camera=ROLLING.replace("64, height: 48", "16, height: 12"))
    assert "1 of 4 are left out: their images, of 0.05 s, would begin" in job.assumed
    job = replace(first_of(job, 1), modes=("depth",))
    capture(replace(job, exposure=Exposure(instants=3)), tmp_path / "yard.sqlite")
    auto = replace(job, source=str(tmp_path / "yard.sqlite"), exposure=Exposure(instants="auto"))
    with pytest.raises(ArgumentError, match="instants: expected a number, or a source that tells"):
        run(auto)


def test_a_plan_counts_every_instant(tmp_path):
    """As many captures as there are instants; of an exposure, colour alone but for its middle."""
    one = job_of(tmp_path)
    times = job_of(tmp_path, f"times: [0, 1, 2]\nmotions: {{Cabinet: {SLIDE}}}")
    exposed = f"times: [1]\nmotions: {{Cabinet: {SLIDE}}}\nexposure: {{seconds: 0.1, instants: 3}}"
    blurred = job_of(tmp_path, exposed)
    counts = ({cost.way: cost.requests for cost in costs(job)}["cube"] for job in (one, times, blurred))
    single, thrice, exposed = counts
    assert (single, thrice, exposed) == (18, 54, 18 + 12)
    colour = replace(times, modes=("lit",), options=RenderOptions("cube", face_size=16))
    assert capture(colour, tmp_path / "kept.sqlite").needed == 3 * 6


def test_wrong_keys_are_refused_before_a_source_is_opened(tmp_path):
    for more, says in (
        ("motions: [Cabinet]", "motions: expected a mapping from objects to motions"),
        ("motions: {Cabinet: 3}", "motions.Cabinet: expected waypoints, {spline: waypoints}, or the name"),
        ("motions: {Cabinet: [{position: [0, 0, 0]}, {position: [1, 0, 0]}]}", "missing key 'time'"),
        (
            "motions: {Cabinet: [{time: 1, position: [0, 0, 0]}, {time: 1, position: [1, 0, 0]}]}",
            "motions.Cabinet: times: expected increasing seconds",
        ),
        (f"motions: {{Cabinet: {SLIDE}}}", "times: expected them where something moves"),
        (f"times: [7, 8]\nmotions: {{Cabinet: {SLIDE}}}", "the job's times, 7 to 8 s, got 0 to 2 s"),
        ("times: poses", "times: expected poses with times, got some without"),
        ("times: {rate: 10}", "times: missing key 'count', as the poses have no times"),
        ("exposure: {seconds: 1, instants: 4}", "exposure.instants: expected an odd number, got 4"),
        ("exposure: {seconds: 1}", "times: expected them where something moves"),
    ):
        with pytest.raises(ArgumentError) as failed:
            job_of(tmp_path, more)
        assert says in str(failed.value)
        assert len(str(failed.value)) <= 1000


def test_motions_need_a_world_that_has_the_objects_and_places_them(tmp_path):
    with pytest.raises(ArgumentError, match="freeze: expected auto, puppet, batch or none for motions and"):
        job_of(tmp_path, f"times: [0]\nmotions: {{Cabinet: {SLIDE}}}\nfreeze: pause")
    assert job_of(tmp_path, "freeze: pause").freeze == "pause"
    with pytest.raises(ArgumentError, match="expected objects of the scene, got 'Cupboard'"):
        run(job_of(tmp_path, "motions: {Cupboard: [{position: [0, 0, 1]}]}"))


def error_of(count, px):
    """Largest error of an edge of full contrast that moves, in the box of a pixel: a mean of few instants."""
    x = np.linspace(-px, px, 4_001)

    def seen(n):
        shifts = px * ((np.arange(n) + 0.5) / n - 0.5)
        return np.mean([np.clip(x - shift + 0.5, 0, 1) for shift in shifts], axis=0)

    return np.abs(seen(count) - seen(1024)).max()


def test_twice_as_many_instants_as_pixels_of_motion():
    """Their mean is within two levels of a full edge."""
    counts = {0: 3, 1: 9, 4: 17, 16: 33, 64: 129, 1e6: 999}
    assert {px: instants_for(px) for px in counts} == counts
    assert max(error_of(instants_for(px), px) for px in (0.5, 2, 7, 16, 40)) < 2 / 255


def test_motion_is_measured_in_pixels():
    camera = create("fisheye-equidistant", width=200, height=200, focal=60.0)
    still, turned, moved = (Pose.from_angles((x, 0, 1.2), yaw) for x, yaw in ((0, 0), (0, 10), (0.1, 0)))
    slide = Motion(Trajectory.timed([object_pose((3.5, y, 1.2), 0) for y in (0, 1.2)], (0.0, 2.0)), "linear")
    for poses, motions, px in (
        ((still, turned), (), 60 * np.radians(10)),
        ((still, moved), (), 6),
        ((still, still), (slide,), 60 * 0.2),
    ):
        assert motion_px(camera, poses, motions, (0, 10**9)) == pytest.approx(px, rel=0.3)


def test_moving_objects_need_instants_too(tmp_path):
    more = "times: [0.5]\nexposure: {seconds: 0.25, instants: auto}"
    jobs = (job_of(tmp_path, more + moved) for moved in ("", f"\nmotions: {{Cabinet: {SLIDE}}}"))
    counts = [len(next(frames_by_instant(job)).captured) for job in jobs]
    assert counts[0] == 3 < counts[1]
