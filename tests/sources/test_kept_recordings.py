"""The recordings kept in ``captures/``: composed without a server, and judged by the rooms they were made of;
``living-room.sqlite``, Blender's, by tests/sources/blender/test_recorded_room.py.

With ``--record-mode=rewrite`` these tests make the recordings (``scripts/make-captures``).
"""

import hashlib
import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import mock_server
import omniscv
from omniscv.sources import Request
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.recording.rows import view_from_json
from omniscv.sources.recording.store import Store

ROOMS = ("four-wall", "six-wall")
FACE_PX, STRIP_FACE_PX = 192, 56
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
    """Faces at two places, in all modes, and the strips of a panorama on a circle."""
    wide = omniscv.cameras.create("equirectangular", width=256, height=128)
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
    image = omniscv.render(
        circle, HERE, recorded_source, ("lit",), strategy="strips", face_size=STRIP_FACE_PX
    )
    assert mean_difference(image, traced(scene, image)) <= GREY_LEVELS


GREY_LEVELS = 4.0
"""Edges are softened by the filter; a picture that is mirrored or turned differs by tens."""


def traced(scene, image):
    """What each pixel's own ray meets."""
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


DECODED = {
    "four-wall": {
        "lit": {0: "f75cdf813adb13dc", 194: "6abd8af62a57d714", 291: "53f995633694983d"},
        "object_mask": {6: "3da42275b2d9df16", 34: "02d1717f80ac0511"},
        "depth": {12: "fd1026d7feb3ad3c", 40: "3713e4b4926550b1"},
        "normals": {18: "e64ea27e5b8b4739", 46: "7e2ae5b7a7e8333c"},
    },
    "six-wall": {
        "lit": {0: "65faffd7e5b79881", 194: "b746fdff8b422bbc", 291: "028e1eba9bf5a2e0"},
        "object_mask": {6: "df8982fce245b1f0", 34: "bc6147ccdde601c1"},
        "depth": {12: "7a7a5db5cabf955b", 40: "e5612f5c0de9eab3"},
        "normals": {18: "311c7c2ac70460da", 46: "1ccbf606197612d1"},
    },
}
"""Beginnings of the SHA-256 of pixels, by mode and row, as decoded at 07d31f4 (``normal`` then)."""

COLORS = {"four-wall": (20, "836c4c467cf983af"), "six-wall": (22, "a30a148dc504569c")}


@pytest.mark.block_network
@pytest.mark.parametrize("room", ROOMS)
def test_kept_recordings_replay_to_the_pixels_of_the_first_version(room, recorded_dir):
    """They were recorded by the first version, and converted."""
    path = recorded_dir / f"{room}.sqlite"
    with closing(Store(path)) as store:
        views = [view_from_json(row.asked) for row in store.listing()]
    with omniscv.open_source(path) as replay:
        for mode, hashes in DECODED[room].items():
            captures = replay.capture(Request(views[row], mode) for row in hashes)
            assert [digest(capture.pixels.tobytes()) for capture in captures] == list(hashes.values())
        table = replay.objects()
        assert (table.tolerance, table.ids) == (3, {})
        assert (len(table.colors), digest(json.dumps(sorted(table.colors.items())).encode())) == COLORS[room]


def digest(data):
    return hashlib.sha256(data).hexdigest()[:16]
