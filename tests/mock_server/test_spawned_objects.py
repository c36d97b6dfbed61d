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


@pytest.mark.parametrize(
    ("dialect", "taken"), list(zip(MODERN, ["exsit", "exsit", "exists", "exists"], strict=True))
)
def test_objects_are_spawned_and_destroyed(world, dialect, taken):
    client = world(dialect)
    assert client.text("vset /objects/spawn CubeActor Box") == "Box"
    assert client.text("vget /objects").endswith(" Box ")
    assert client.text("vset /objects/spawn CubeActor Box") == f"error Failed to spawn Box, object {taken}."
    assert client.text("vset /objects/spawn CubeActor") == "CubeActor_1"
    assert client.text("vset /objects/spawn_cube") == ("CubeActor_2" if taken == "exists" else "ok")
    named = client.text("vset /objects/spawn_cube Dice")
    assert (named, "Dice" in client.text("vget /objects").split()) == (
        ("Dice", True) if taken == "exists" else ("ok", False)
    )
    assert client.text("vget /object/Box/bounds") == "-50.00 -50.00 -50.00 50.00 50.00 50.00"
    assert client.text("vget /object/Box/uclass_name") == ("CubeActor" if taken == "exists" else "Actor")
    assert client.text("vget /object/Box/mobility") == "Movable"
    assert client.text("vset /object/Box/destroy") == "ok"
    assert "Box" not in client.text("vget /objects").split()
    assert client.text("vget /object/Box/location").startswith("error Can")
    assert client.text("vset /objects/spawn CubeActor Box") == "Box"


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


@pytest.mark.parametrize("dialect", MODERN)
def test_scales(world, dialect):
    client = world(dialect)
    assert client.text("vget /object/Bench/scale") == "1.000 1.000 1.000"
    client.ask("vset /objects/spawn CubeActor Box")
    assert client.text("vset /object/Box/scale 0.5 1.0 2.0") == "ok"
    assert client.text("vget /object/Box/scale") == "0.500 1.000 2.000"
    assert client.text("vget /object/Box/bounds") == "-25.00 -50.00 -100.00 25.00 50.00 100.00"
    client.ask("vset /object/Box/rotation 0 90 0")  # scales are along the object's own axes
    assert client.text("vget /object/Box/bounds") == "-50.00 -25.00 -100.00 50.00 25.00 100.00"
    client.ask("vset /object/Box/scale 0 0 0")
    client.ask("vset /object/Lamp/scale 0 0 0")
    assert client.text("vget /object/Box/bounds") == "0.00 0.00 0.00 0.00 0.00 0.00".replace(
        "0.00", "-0.00", 3
    )
    assert depth(client).shape == SIZE[::-1]
    client.ask("vset /object/Box/scale 1 1 1")
    assert client.text("vget /object/Box/bounds") == "-50.00 -50.00 -50.00 50.00 50.00 50.00"


def test_l_spawns_nothing(world):
    client = world("L")
    for command in (
        "vset /objects/spawn CubeActor Box",
        "vset /objects/spawn_cube",
        "vset /object/Crate/scale 1 1 1",
    ):
        assert client.text(command) == f"error Can not find a handler for URI '{command}'"


@pytest.mark.parametrize("dialect", MODERN)
def test_a_name_that_is_taken_is_not_given_again(world, dialect):
    client = world(dialect)
    refused = "error Renaming an object to overwrite an existing object is not allowed, Bench"
    assert client.text("vset /object/Crate/name Bench") == refused
    assert client.text("vset /object/Crate/name Crate") == "The name has already been set"


@pytest.mark.parametrize(
    ("dialect", "command", "reply"),
    [
        ("L", "vexec Crate Jump", "error Fail to execute the function 'Jump' of Crate"),
        ("L", "vexec Cow Jump", "error Can not find actor with id 'Cow'"),
        ("N1", "vexec Crate Jump", "ok"),
        ("N1", "vbp Crate Jump high", "error Fail to execute the function 'Jump' of Crate"),
        ("N2", "vbp Cow Jump", "error Can not find actor with id 'Cow'"),
        ("N2", "vexec Crate Jump 1 2 3", "ok"),
    ],
)
def test_functions_that_plain_actors_do_not_have(world, dialect, command, reply):
    assert world(dialect).text(command) == reply
