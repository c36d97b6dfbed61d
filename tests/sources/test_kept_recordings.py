"""The recordings in ``captures/``, made by these tests (``scripts/make-captures``), against their rooms."""

from pathlib import Path

import numpy as np
import pytest

import mock_server
import omniscv
from omniscv.sources.recording.inspection import info, verify

ROOMS = ("four-wall", "six-wall")
FACE_PX = 192
STRIP_FACE_PX = 56
HERE = omniscv.Pose.from_angles((0.0, 0.0, 1.5))
THERE = omniscv.Pose.from_angles((0.8, -0.6, 1.2))
ALL_BYTES = 15e6


@pytest.fixture(scope="module")
def recorded_dir():
    return Path(__file__).parents[2] / "captures"


def kept(test):
    """For each room: replayed from its recording, which is made of the mock server's room of that name."""
    rooms = [
        pytest.param(
            room, marks=[pytest.mark.recorded(f"{room}.sqlite"), pytest.mark.unreal(scene=room)], id=room
        )
        for room in ROOMS
    ]
    return pytest.mark.block_network(pytest.mark.parametrize("room", rooms)(test))


@kept
def test_images_of_kept_recordings_are_the_traced_rooms(room, recorded_source):
    wide = omniscv.cameras.create("equirectangular", width=128, height=64)
    circle = omniscv.cameras.create("noncentral-panorama", width=128, height=64, radius=0.5)
    scene = mock_server.load_scene(room)
    for pose in (HERE, THERE):
        modes = ("lit", "object_mask", "depth", "normals")
        image = omniscv.render(wide, pose, recorded_source, modes, strategy="cube", face_size=FACE_PX)
        hits = traced(scene, image)
        # The server sends half floats: half a step of 2^-11 relative at most, 2^-12 in the middle.
        assert np.median(np.abs(image.depth - hits.distance) / hits.distance) <= 1e-3
        assert (image.labels == hits.label).mean() >= 0.99
        assert mean_difference(image, hits) <= GREY_LEVELS
    image = omniscv.render(circle, HERE, recorded_source, ("lit",), strategy="exact", face_size=STRIP_FACE_PX)
    assert mean_difference(image, traced(scene, image)) <= GREY_LEVELS


GREY_LEVELS = 4.0
"""Edges are softened by the filter; a picture that is mirrored or turned differs by tens."""


def traced(scene, image):
    rays = image.camera.unproject()
    assert rays.valid.all()
    return scene.trace(image.pose.to_world(rays.origins), rays.directions @ image.pose.R_w_c.T)


def mean_difference(image, hits):
    return np.abs(image.lit - 255 * hits.color).mean()


def test_kept_recordings_are_whole_and_small(recorded_dir):
    files = sorted(recorded_dir.glob("*.sqlite"))
    assert [file.stem for file in files] == sorted([*ROOMS, "living-room"])
    assert sum(file.stat().st_size for file in files) < ALL_BYTES
    for file in files:
        assert verify(file).ok
        assert info(file).scenes == [file.stem]
        assert info(file).captures.keys() == {"lit", "object_mask", "depth", "normals"}
