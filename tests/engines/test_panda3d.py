"""A rasteriser of others, Panda3D, behind the socket: textures, a depth buffer, half floats on the wire.

Its pictures are judged by the triangles of the file that it draws.
"""

import glb_room
import numpy as np
import pytest
import unrealcv
from panda_scene import PandaScene
from support.judged import Errors

import mock_server
import omniscv
from omniscv.diagnostics.doctor import examine_address

POSE = omniscv.Pose.from_angles((0.1, -0.2, 1.5), 25, -5, 3)
CAMERAS = {
    "fisheye": omniscv.cameras.create("fisheye-equidistant", width=96, height=96, fov_deg=190),
    "ring": omniscv.cameras.create("noncentral-panorama", width=96, height=48, radius=0.3),
    "mirror ball": omniscv.cameras.create(
        "noncentral-spherical-mirror", width=64, height=64, mirror_radius=0.3, distance=0.3, fov_deg=280
    ),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("room") / "room.glb"
    glb_room.write(path)
    return PandaScene("glb-room", path)


@pytest.fixture(params=["N3", "0.3.10"])
def server(scene, request):
    with mock_server.serve(scene, port=0, dialect=request.param, size=(256, 256)) as server:
        yield server


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_recorded_and_composed_images_are_within_their_bounds(server, scene, camera, tmp_path):
    triangles = glb_room.Triangles(scene.objects)
    modes = ("lit", "object_mask", "depth")
    path = tmp_path / "room.sqlite"
    with omniscv.record(omniscv.open_source(server.uri), path) as source:
        live = omniscv.render(camera, POSE, source, modes)
    with omniscv.open_source(path) as replay:
        image = omniscv.render(camera, POSE, replay, modes)
    assert all(np.array_equal(image[name], live[name]) for name in ("lit", "labels", "depth"))
    found = Errors(image, triangles)
    assert found.uncovered[image.valid].mean() <= 5e-4
    assert found.label[image.valid].mean() < 0.02
    assert len(np.unique(image.lit[image.valid], axis=0)) > 1000  # textures


def test_the_official_client_moves_things_and_sees_them_move(scene):
    with mock_server.serve(scene, port=0, size=(64, 64)) as server:
        client = unrealcv.Client((server.host, server.port))
        assert client.connect()
        try:
            assert client.request("vget /objects").split() == list(scene.objects)
            before = client.request("vget /camera/0/lit png")
            assert client.request("vset /object/Ball/location 200 0 150") == "ok"
            assert client.request("vget /object/Ball/location").split()[0] == "200.000"
            assert client.request("vget /camera/0/lit png") != before
        finally:
            client.disconnect()


def test_the_doctor_finds_nothing_that_is_not_there(server):
    bad = [finding for finding in examine_address(server.uri) if finding.verdict == "bad"]
    assert not bad


@pytest.mark.parametrize(
    ("fault", "found"),
    [("vignette=0.3", "vignette"), ("ray-depth", "depth is"), ("turned=0.3", "depth, turned")],
)
def test_the_doctor_finds_what_is_injected(scene, fault, found):
    with mock_server.serve(scene, port=0, size=(128, 128), faults=[fault]) as server:
        assert found in {finding.name for finding in examine_address(server.uri) if finding.verdict == "bad"}
