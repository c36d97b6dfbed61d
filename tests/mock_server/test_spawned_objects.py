"""Objects that commands add, scale, rename and call, in each dialect."""

import numpy as np
import pytest
from support.expected_views import npy, png

SIZE = (20, 16)
MODERN = ("M", "N1", "N2", "N3")


@pytest.fixture
def world(start, open_raw):
    """Starts a server of a paused world, and a client with a camera over the origin."""

    def start_one(dialect):
        client = open_raw(start("workshop", dialect=dialect, size=SIZE, frames_per_s=1e-3, depth="float32"))
        for command in ("/action/game/pause", "/cameras/spawn", "/camera/1/location 0 0 130"):
            client.ask(f"vset {command}")
        return client

    return start_one


def depth(client):
    """Planar depth, metres."""
    return npy(client.ask("vget /camera/1/depth npy")) / 100


def test_a_spawned_box_is_in_lit_at_once_and_in_depth_and_masks_once_it_has_a_colour(world):
    client = world("N1")
    client.ask("vset /objects/spawn CubeActor Box")
    before, lit = depth(client), client.ask("vget /camera/1/lit png")
    client.ask("vset /object/Box/location 200 0 130")
    assert np.array_equal(depth(client), before)
    assert client.ask("vget /camera/1/lit png") != lit
    client.ask("vset /object/Box/color 7 8 9")
    seen = (png(client.ask("vget /camera/1/object_mask png"))[..., :3] == (7, 8, 9)).all(axis=-1)
    # The cube's front is 1.5 m away and 1 m wide, of 3 m that the view spans there.
    width = SIZE[0] / 3
    assert seen.sum() == pytest.approx(width**2, rel=0.3)
    assert depth(client)[seen] == pytest.approx(1.5, abs=1e-5)
    assert (np.abs(depth(client) - before)[~seen] < 1e-5).all()


def test_labels_of_other_objects_are_the_same_with_a_spawned_one(world):
    client = world("N1")
    before = client.ask("vget /camera/1/object_mask png")
    client.ask("vset /objects/spawn CubeActor AAA")
    assert client.ask("vget /camera/1/object_mask png") == before
