"""Jobs whose cameras are 'of' cameras of a model: images from where MuJoCo has these, at the same instant."""

import numpy as np
import pytest

import omniscv
from omniscv import storage
from omniscv.dataset import manifest
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.make import capture, check_worlds, costs, make, run
from omniscv.make.instants import frames_by_instant
from omniscv.make.source import opened

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

ARM = """
<mujoco><option gravity='0 0 -9.81'/><worldbody>
<geom name='floor' type='plane' size='5 5 .1' rgba='.2 .6 .3 1'/>
<geom name='box' type='box' size='.2 .3 .2' pos='.3 1.5 .2' rgba='.8 .2 .1 1'/>
<geom name='ball' size='.15' pos='-.4 1.2 .5'/>
<camera name='front' pos='0 -1 .8' euler='75 0 0' fovy='60' resolution='80 40'/>
<body name='hand' pos='0 0 1'>
 <joint type='slide' axis='0 0 1'/>
 <joint type='hinge' axis='0 0 1' stiffness='.1' springref='90'/>
 <geom name='palm' size='.05' contype='0'/>
 <camera name='wrist' pos='0 -.3 .1' euler='70 5 0' fovy='50' resolution='160 120'/>
</body></worldbody></mujoco>"""
PINHOLE = {"model": "pinhole", "of": "wrist"}
FISHEYE = {"model": "fisheye-equidistant", "width": 64, "height": 48, "fov_deg": 190, "of": "wrist"}
PANORAMA = {"model": "equirectangular", "width": 32, "height": 16}
AT = [{"position": [0, 0, 1.5]}]
TIMES_S = (0.0, 0.1, 0.2)


def job_of(folder, **keys):
    file = folder / "arm.xml"
    file.write_text(ARM)
    job = {
        "source": f"mujoco://{file}?by=geom",
        "cameras": {"wrist": PINHOLE},
        "modes": ["object_mask", "depth"],
        "face_size": 256,
        "out": str(folder / "out"),
    }
    return load({key: value for key, value in (job | keys).items() if value is not None})


def states():
    """The model, and its data at each of the times, by MuJoCo's own steps."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    for time in TIMES_S:
        while data.time < time - 1e-9:
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        yield model, data


def met(model, data, directions):
    """Distances along directions of MuJoCo's camera (x right, y up, z back) from it, by MuJoCo's rays."""
    camera = model.camera("wrist").id
    group = np.zeros(1, np.int32)
    return np.array(
        [
            mujoco.mj_ray(model, data, data.cam_xpos[camera], ray, None, 1, -1, group)
            for ray in directions @ data.cam_xmat[camera].reshape(3, 3).T
        ]
    )


def rendered(model, data):
    """Planar depth and names of geoms, by MuJoCo's renderer from its own camera."""
    with mujoco.Renderer(model, 120, 160) as renderer:
        renderer.update_scene(data, camera="wrist")
        renderer.enable_depth_rendering()
        depth = renderer.render().copy()
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        names = np.array(["", *(model.geom(number).name for number in range(model.ngeom))])
        return depth, names[1 + renderer.render()[..., 0]]


def test_a_pinhole_without_a_lens_shows_what_mujocos_renderer_does_as_the_camera_moves(tmp_path):
    job = job_of(tmp_path, times=list(TIMES_S))
    images = []
    run(job, done=images.append)
    for image, (model, data) in zip(images, states(), strict=True):
        assert (image.camera.width, image.camera.height) == (160, 120)
        depth, names = rendered(model, data)
        directions = image.camera.unproject(image.camera.pixels()).directions
        shown = np.array(["", *image.objects.names()])[image.labels]
        sure = ~image.label_edge & np.isfinite(image.depth)
        assert sure.mean() > 0.5
        assert (shown == names)[sure].mean() > 0.99
        planar = image.depth * directions[..., 2]
        assert np.median(np.abs(planar - depth)[sure] / depth[sure]) < 2e-3


def test_a_fisheye_has_the_distances_of_mujocos_rays_from_the_moving_camera(tmp_path):
    job = job_of(tmp_path, cameras={"fish": FISHEYE}, times=list(TIMES_S))
    make(job)
    frames = list(omniscv.dataset.open(tmp_path / "out"))
    assert [frame.time_ns for frame in frames] == [0, 100_000_000, 200_000_000]
    for frame, (model, data) in zip(frames, states(), strict=True):
        camera = model.camera("wrist").id
        np.testing.assert_allclose(frame.pose.position, data.cam_xpos[camera], atol=1e-9)
        rays = frame.camera.unproject(frame.camera.pixels()[::4, ::4])
        depth = frame.layer("depth")[::4, ::4][rays.valid]
        sure = np.isfinite(depth) & ~frame.layer("label_edge")[::4, ::4][rays.valid]
        assert sure.mean() > 0.3
        truth = met(model, data, rays.directions[rays.valid][sure] * (1, -1, -1))
        error = frame.layer("depth_error")[::4, ::4][rays.valid][sure]
        assert (np.abs(depth[sure] - truth) <= error + 1e-4).mean() > 0.99


def test_the_manifest_has_the_lens_of_the_models_camera_and_resuming_keeps_all_frames(tmp_path):
    job = job_of(tmp_path, times=list(TIMES_S))
    assert make(job).written == 3
    view = opened_source_view(job)
    camera = manifest.read(storage.folder(tmp_path / "out")).cameras["wrist"]
    assert (camera.width, camera.height) == (view.width, view.height)
    edges = camera.unproject(np.array([[0, view.height / 2], [view.width, view.height / 2]])).directions
    assert np.degrees(np.arccos(edges[0] @ edges[1])) == pytest.approx(view.fov_deg)
    assert make(job, existing="resume").kept == 3


def opened_source_view(job):
    with omniscv.open_source(job.source) as source:
        return source.own_views()["wrist"]


def test_parts_have_the_frames_of_a_dataset_that_is_made_at_once(tmp_path):
    keys = {"cameras": {"fish": FISHEYE}, "times": list(TIMES_S)}
    make(job_of(tmp_path, **keys))
    whole = (tmp_path / "out" / "frames.jsonl").read_bytes()
    shards = job_of(tmp_path, **keys, out=str(tmp_path / "parts"))
    for part in range(2):
        make(shards, shard=(part, 2))
    assert (tmp_path / "parts" / "frames.jsonl").read_bytes() == whole


def poses_of(job):
    with opened(job) as (known, _):
        return {frame.key: frame.pose for shared in frames_by_instant(known) for frame in shared.frames}


def test_a_camera_on_a_body_moves_with_the_motions_of_the_job(tmp_path):
    moved = [{"time": 0, "position": [0, 0, 1]}, {"time": 1, "position": [2, 0, 3], "yaw_deg": 90}]
    address = f"mujoco://{tmp_path / 'arm.xml'}"
    poses = poses_of(job_of(tmp_path, source=address, times=[0, 1], motions={"hand": moved}))
    np.testing.assert_allclose(poses["wrist-0"].position, (0, -0.3, 1.1), atol=1e-9)
    np.testing.assert_allclose(poses["wrist-1"].position, (2 + 0.3, 0, 3.1), atol=1e-9)


def test_cameras_at_poses_stay_there_beside_one_of_the_model(tmp_path):
    cameras = {"wrist": PINHOLE, "panorama": PANORAMA}
    poses = poses_of(job_of(tmp_path, cameras=cameras, poses=AT))
    np.testing.assert_allclose(poses["panorama"].position, (0, 0, 1.5))
    np.testing.assert_allclose(poses["wrist"].position, (0, -0.3, 1.1), atol=1e-9)


def test_plans_and_captures_are_those_of_an_image_at_the_models_pose(tmp_path):
    cameras = {"fish": FISHEYE}
    job = job_of(tmp_path, cameras=cameras)
    view = opened_source_view(job)
    yaw, pitch, roll = view.pose.angles()
    at = {"position": view.pose.position.tolist(), "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll}
    lens = {key: value for key, value in FISHEYE.items() if key != "of"}
    placed = job_of(tmp_path, cameras={"fish": lens}, poses=[at])
    assert costs(job) == costs(placed)
    captured = capture(job, tmp_path / "own.sqlite")
    assert captured.new == capture(placed, tmp_path / "placed.sqlite").new > 0
    again = job_of(tmp_path, cameras=cameras, record=str(tmp_path / "own.sqlite"))
    run(again)
    assert capture(again, tmp_path / "own.sqlite").new == 0


REFUSED = {
    "unknown name": ({"cameras": {"wrist": {**PINHOLE, "of": "wirst"}}}, "did you mean wrist"),
    "no name": ({"cameras": {"wrist": {**PINHOLE, "of": 3}}}, "cameras.wrist.of: expected"),
    "poses": ({"poses": AT}, "poses: expected none, as every camera is 'of' one of the scene"),
    "no poses": ({"cameras": {"wrist": PINHOLE, "pano": PANORAMA}}, "missing key 'poses'"),
    "times of poses": ({"times": "poses"}, "list the times"),
    "no cameras": (
        {"source": "scene://four-wall"},
        "cameras.wrist.of: .*; leave 'of' out",
    ),
    "lens": ({"cameras": {"wrist": {**PINHOLE, "fov_deg": 50}}}, "cameras.wrist: camera pinhole: expected"),
    "exposure": (
        {"times": [0, 1], "exposure": {"seconds": 0.1}},
        "exposure.seconds: expected 0 for 'wrist', which is 'of' a camera of the scene",
    ),
    "rig": (
        {"rig": {"cameras": {"wrist": {"camera": {**PANORAMA}}}}, "poses": AT},
        "cameras: expected names that the rig has not, got wrist",
    ),
    "in a rig": (
        {"cameras": None, "rig": {"cameras": {"wrist": {"camera": FISHEYE}}}, "poses": AT},
        "rig.*got 'of'",
    ),
    "places": (
        {"vary": {"per": "place", "objects": {"ball": {"shift": 0.1}}}},
        "vary.per: expected frame or world for 'wrist'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_contradicts_a_camera_of_the_model_is_refused(tmp_path, case):
    keys, words = REFUSED[case]
    with pytest.raises(ArgumentError, match=words):
        check_worlds(job_of(tmp_path, **keys), dataset=True)


def test_a_recording_has_no_cameras_of_its_own(tmp_path):
    job = job_of(tmp_path)
    capture(job, tmp_path / "own.sqlite")
    with pytest.raises(ArgumentError, match=r"cameras\.wrist\.of: .*got a recording; leave 'of' out"):
        run(job_of(tmp_path, source=str(tmp_path / "own.sqlite")))
