"""A rig's cameras share what they can: captures counted, and images as they are alone."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.recordings import CountingSource

import omniscv
from omniscv import Pose, Rig, RigCamera, cameras
from omniscv.errors import ArgumentError

LENS = cameras.create("fisheye-equidistant", width=24, height=24, fov_deg=190)
SPHERE = cameras.create("equirectangular", width=32, height=16)
AROUND = {f"lens{yaw}": RigCamera.turned(LENS, yaw_deg=yaw) for yaw in (0, 90, 180, 270)}
ROUND = Rig({**AROUND, "sphere": RigCamera(SPHERE)})


@pytest.fixture
def source() -> Iterator[CountingSource]:
    with omniscv.open_source("scene://four-wall") as scene, CountingSource(scene) as counting:
        yield counting


def test_five_cameras_take_six_captures_a_pose(source: CountingSource) -> None:
    for i in range(4):
        pose = Pose.from_angles((-1 + i / 2, 0.3, 1.5), yaw_deg=88 * i, pitch_deg=12 * i - 25)
        images = omniscv.render_rig(ROUND, pose, source, face_size=16)
        assert list(images) == [*AROUND, "sphere"]
        assert all(image.valid.any() for image in images.values())
    assert len(set(source.requests)) == len(source.requests)
    assert Counter(request.mode for request in source.requests) == {"lit": 24}
    places = {tuple(request.view.pose.position) for request in source.requests}
    assert len(places) == 4


def test_an_image_is_the_one_that_its_camera_takes_alone_of_the_same_faces(source: CountingSource) -> None:
    pose = Pose.from_angles((0.2, 0.1, 1.4), yaw_deg=33, pitch_deg=-8)
    modes = ("lit", "object_mask", "depth")
    rig = Rig({name: ROUND.cameras[name] for name in ("lens90", "sphere")})
    together = omniscv.render_rig(rig, pose, source, modes)
    edge = max(image.options.face_size for image in together.values())
    for name, own in rig.poses(pose).items():
        camera = rig.cameras[name].camera
        alone = omniscv.render(camera, own, source, modes, strategy="exact", face_size=edge)
        for layer in ("lit", "labels", "depth"):
            np.testing.assert_array_equal(together[name][layer], alone[layer], err_msg=f"{name} {layer}")


def test_the_finest_camera_decides_on_the_faces_that_all_share(source: CountingSource) -> None:
    fine = cameras.create("fisheye-equidistant", width=512, height=512, fov_deg=190)
    rig = Rig({"coarse": RigCamera(SPHERE), "fine": RigCamera(fine)})
    pose = Pose.from_angles((0, 0, 1.5))
    sizes = {}
    for name, mounted in rig.cameras.items():
        source.requests.clear()
        omniscv.render(mounted.camera, pose, source)
        sizes[name] = {request.view.width for request in source.requests}
    source.requests.clear()
    omniscv.render_rig(rig, pose, source)
    assert {request.view.width for request in source.requests} == sizes["fine"] != sizes["coarse"]


def test_cameras_apart_share_nothing_and_noncentral_ones_at_one_place_what_they_need(
    source: CountingSource,
) -> None:
    apart = Rig({"left": RigCamera(SPHERE), "right": RigCamera.turned(SPHERE, position=(0.1, 0, 0))})
    omniscv.render_rig(apart, Pose.from_angles((0, 0, 1.5)), source, face_size=16)
    places = Counter(tuple(request.view.pose.position.round(9)) for request in source.requests)
    assert places == {(0, 0, 1.5): 6, (0, -0.1, 1.5): 6}
    source.requests.clear()
    panorama = cameras.create("noncentral-panorama", width=8, height=4, radius=0.3)
    rig = Rig({"one": RigCamera(panorama), "other": RigCamera(panorama)})
    images = omniscv.render_rig(rig, Pose.from_angles((0, 0, 1.5)), source)
    assert len(set(source.requests)) == len(source.requests)
    np.testing.assert_array_equal(images["one"].lit, images["other"].lit)


def test_other_values_than_rigs_are_refused(source: CountingSource) -> None:
    with pytest.raises(ArgumentError, match="rig: expected a Rig, got"):
        omniscv.render_rig({"a": SPHERE}, Pose.from_angles((0, 0, 1.5)), source)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="options: expected some of"):
        omniscv.render_rig(ROUND, Pose.from_angles((0, 0, 1.5)), source, size=3)  # type: ignore[call-arg]


NARROW = cameras.create("pinhole", width=64, height=48, fov_deg=2)
LONG = {"a": RigCamera(NARROW), "b": RigCamera.turned(NARROW, yaw_deg=90)}
RIGS = {"both": Rig({**ROUND.cameras, **LONG}), "narrow": Rig(LONG)}
VIEWS = {"both": 6 + 2, "narrow": 2}


@pytest.mark.parametrize("name", RIGS)
def test_a_recording_of_a_rig_replays_to_the_same_images(name: str, tmp_path: Path) -> None:
    """What is shared is decided again and comes out the same; narrow cameras are captured alone."""
    pose = Pose.from_angles((0.3, 0.2, 1.5), yaw_deg=20)
    path = tmp_path / "room.sqlite"
    with omniscv.open_source("scene://four-wall") as scene, omniscv.record(scene, path) as recording:
        live = omniscv.render_rig(RIGS[name], pose, recording, ("lit", "depth"))
    with omniscv.open_source(path) as recorded, CountingSource(recorded) as replay:
        again = omniscv.render_rig(RIGS[name], pose, replay, ("lit", "depth"))
        assert len(replay.requests) == 2 * len(recorded.recorded_views() or ()) == 2 * VIEWS[name]
    for camera, image in live.items():
        np.testing.assert_array_equal(image.lit, again[camera].lit)
        np.testing.assert_array_equal(image.depth, again[camera].depth)
