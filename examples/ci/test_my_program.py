"""A program that speaks UnrealCV, tested without Unreal: the mock server runs for each test."""

import io

import numpy as np
import pytest
import unrealcv

import omniscv


def nearest_m(port):
    """The program that is tested: how near is what the camera sees?"""
    client = unrealcv.Client(("127.0.0.1", port))
    client.connect()
    try:
        depth = np.load(io.BytesIO(client.request("vget /camera/0/depth npy")))
    finally:
        client.disconnect()
    return float(depth.min()) / 100  # the plugin's centimetres


@pytest.mark.unreal("four-wall", size=(64, 64))
def test_the_nearest_surface(unreal_server):
    with omniscv.open_source("scene://four-wall") as source:
        camera = omniscv.cameras.create("pinhole", width=64, height=64, fov_deg=90)
        image = omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source, ("depth",))
    planar = image.depth * camera.unproject().directions[..., 2]
    assert nearest_m(unreal_server.port) == pytest.approx(np.nanmin(planar), rel=0.01)  # half floats
