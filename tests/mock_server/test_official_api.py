"""The official high-level ``UnrealCv_API`` takes the mock for a game."""

import logging

import numpy as np
import pytest
from support.wire import leave, official_api

import mock_server

SIZE = (48, 36)


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("four-wall", size=SIZE) as server:
        yield server


@pytest.fixture(scope="module")
def api(server):
    logging.getLogger("unrealcv").setLevel(logging.CRITICAL)
    api = official_api(server, SIZE)
    yield api
    leave(api.client)


def test_construction_asks_for_what_the_reference_says(server, api):
    asked = list(server.statistics.counts)
    assert asked[0] == "vget /unrealcv/commands"
    assert server.statistics.counts["vget /unrealcv/commands"] == 2
    assert asked[1:7] == [
        "vget /unrealcv/version",
        "vget /cameras",
        "vget /camera/0/location",
        "vget /camera/0/rotation",
        "vget /camera/0/fov",
        "vget /objects",
    ]


def test_cameras(api):
    assert api.camera_info() == {
        0: {"location": [0.0, 0.0, 150.0], "rotation": [0.0, 0.0, 0.0], "fov": "90.000000"}
    }
    assert api.get_camera_num() == 1


def test_objects_and_their_colours(server, api):
    scene = server.scene
    assert api.get_objects() == list(scene.objects)
    assert set(api.obj_dict) == set(scene.objects)
    assert len({tuple(color) for color in api.obj_dict.values()}) == len(scene.objects)


def test_bmp_is_shifted_by_one_pixel_as_from_a_real_server(api):
    png, bmp = api.get_image(0, "lit", "png"), api.get_image(0, "lit", "bmp")
    assert bmp.shape == png.shape
    np.testing.assert_array_equal(bmp.reshape(-1, 3)[1:], png.reshape(-1, 3)[:-1])


def test_images_of_several_cameras_and_modes_in_one_list(api):
    api.client.request("vset /cameras/spawn")
    images = api.get_image_multicam([0, 1], "lit", "png")
    assert [image.shape for image in images] == [(SIZE[1], SIZE[0], 3)] * 2
    both = api.get_image_multimodal(1, ["lit", "depth"], ["png", "npy"])
    assert both.shape == (SIZE[1], SIZE[0], 4)


def test_a_camera_is_posed(api):
    api.client.request("vset /cameras/spawn")
    api.init_map()  # the client looks for cameras only once
    camera = api.get_camera_num() - 1
    api.set_cam_pose(camera, [10.0, 20.0, 150.0, 5.0, 30.0, 0.0])
    assert api.get_cam_location(camera) == pytest.approx([10, 20, 150])
    assert api.get_cam_rotation(camera) == pytest.approx([5, 30, 0], abs=2e-3)  # printed to 1e-3
    api.set_cam_fov(camera, 60.0)
    assert float(api.get_cam_fov(camera)) == 60
