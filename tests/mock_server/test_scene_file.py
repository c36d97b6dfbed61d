"""Descriptions of scenes: what is refused, and how."""

import copy
import re

import pytest

import mock_server
from mock_server import Scene

SQUARE = [[-3, -3], [3, -3], [3, 3], [-3, 3]]
CROSSED = [[0, 0], [2, 0], [2, 3], [1, 3], [1, -1], [0, -1]]
GOOD = {
    "sky": [0, 0.5, 1],
    "room": {"floor": SQUARE, "height": 3},
    "objects": {
        "It": {
            "texture": {"kind": "checker", "colors": [[0, 0, 0], [1, 1, 1]], "scale": 0.5},
            "solids": [{"sphere": 0.2, "at": [1, 0, 1]}],
        }
    },
}
SIZE = "(from 1e-9 to 1e9)"
PLACE = "(from -1e9 to 1e9)"
NAMES = "expected names without spaces, of at most 100 characters"


def changed(path, value):
    description = copy.deepcopy(GOOD)
    *parents, last = path
    place = description
    for key in parents:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return description


SOLID = ("objects", "It", "solids", 0)
TEXTURE = ("objects", "It", "texture")


def test_nonsense_is_refused_with_its_word():
    for path, value, message in (
        (("skye",), [0, 0, 0], "unknown key 'skye'; known keys: objects, pattern, room, sky"),
        (("sky",), [0, 0, 2], "sky: expected 3 numbers (from 0 to 1), got [0, 0, 2]"),
        (("objects",), ["It"], "objects: expected a mapping, got ['It']"),
        (("objects", "Red chair"), {}, f"objects: {NAMES}, got 'Red chair'"),
        (("objects", 7), {}, f"objects: {NAMES}, got 7"),
        (("objects", "It", "solids"), [], "It: solids: expected a list of at least 1, got []"),
        ((*SOLID, "copies"), {"count": 0}, "It: copies: count: expected 1 number (from 1 to 10000), got 0"),
        ((*SOLID, "copies"), {"count": 2, "step": [1]}, "It: copies: step: expected 5 numbers (from -1e9"),
        ((*SOLID, "sphere"), None, "It: expected one of box, sphere, cylinder; got none"),
        ((*SOLID, "box"), [1, 1, 1], "It: expected one of box, sphere, cylinder; got box, sphere"),
        ((*TEXTURE, "kind"), "marble", "It: texture: kind: expected one of plain, checker"),
        ((*TEXTURE, "seed"), 2, "It: texture: unknown key 'seed'; known keys: angle_deg, colors, kind, sc"),
        (TEXTURE, {"kind": "noise", "octaves": 0}, "It: texture: octaves: expected 1 number (from 1 to 1"),
        (TEXTURE, {"kind": "image", "file": "no.png"}, "It: texture: file: expected the file of a picture"),
        ((*TEXTURE, "colors"), [[0, 0, 0]] * 3, "It: texture: colors: expected one or two, got 3"),
        (("room", "floor"), SQUARE[::-1], "room: floor: expected corners counter-clockwise, of edges"),
        (("room", "floor"), CROSSED, "room: floor: expected corners counter-clockwise, of edges"),
        (("room", "floor"), [*SQUARE[:3], [-2, 2]], "room: floor: expected neighbouring corners that differ"),
        (("room", "walls"), [], "room: walls: expected a list of at least 1, got []"),
        (("objects", "It", "movable"), "no", "It: movable: expected true or false, got 'no'"),
        (("pattern",), {"kind": "plaid"}, "pattern: kind: expected direction or waves, got 'plaid'"),
    ):
        with pytest.raises(ValueError, match=f"^bad: {re.escape(message)}[^\n]*$"):
            Scene("bad", changed(path, value))


def test_the_room_and_what_says_so_are_static():
    assert Scene("good", GOOD).objects[:2] == ("It", "Layout_Ceiling")
    assert Scene("good", GOOD).static == set(Scene("good", GOOD).objects) - {"It"}
    assert "It" in Scene("fixed", changed(("objects", "It", "movable"), False)).static
    moving = {**GOOD["objects"]["It"], "movable": False, "moving": {"kind": "steady"}}
    with pytest.raises(ValueError, match=r"^bad: It: movable: expected true with a motion"):
        Scene("bad", changed(("objects", "It"), moving))


@pytest.mark.parametrize("text", ["- 1", "a: [", "a: 2001-99-99", "[" * 5000, "\xff"])
def test_a_file_that_is_no_description_is_refused_in_one_line(tmp_path, text):
    path = tmp_path / "bad.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=r"^[^\n]*(expected|unknown key)[^\n]*$"):
        mock_server.load_scene(path)


FULL = {
    "sky": [0, 0.5, 1],
    "room": {
        "floor": SQUARE,
        "height": 3.0,
        "walls": [{"kind": "stripes", "colors": [[0, 0, 0], [1, 1, 1]], "scale": 0.5, "angle_deg": 10}],
        "floor_texture": {"kind": "wood", "scale": 0.2},
        "ceiling_texture": {"kind": "plain", "colors": [[1, 1, 1]]},
    },
    "objects": {
        "Box": {"solids": [{"box": [1, 2, 3], "at": [1, 0, 1], "turn_deg": 20, "texture": {"scale": 2.0}}]},
        "Ball": {
            "solids": [{"sphere": 0.2, "at": [1, 0, 1]}],
            "moving": {"kind": "steady", "velocity": [0, 1, 0]},
        },
        "Post": {
            "solids": [{"cylinder": [0.1, 2.0], "at": [0, 0, 1]}],
            "moving": {"kind": "swing", "by": [0, 0, 1], "turn_deg": 60, "period_s": 4.0, "about": [1, 2]},
        },
        "Train": {
            "solids": [{"box": [1, 1, 1], "at": [0, 0, 0]}],
            "moving": {"kind": "waypoints", "points": [[0, 0, 0, 0, 0], [1, 1, 0, 0, 90]], "repeat": True},
        },
    },
    "pattern": {"kind": "waves", "period_rad": 0.04},
}
POSITIVE = {"height", "scale", "box", "sphere", "cylinder", "period_s", "period_rad", "sky", "colors"}
"""Words whose numbers are sizes, or colours: none is negative."""


def numbers_in(value, path=()):
    if isinstance(value, (dict, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return [each for key, below in items for each in numbers_in(below, (*path, key))]
    return [path] if isinstance(value, (int, float)) and not isinstance(value, bool) else []


@pytest.mark.parametrize("path", numbers_in(FULL), ids=lambda path: ".".join(map(str, path)))
def test_no_number_of_a_scene_is_taken_as_it_comes(path):
    assert Scene("full", FULL).objects
    word = next(key for key in reversed(path) if isinstance(key, str))
    for wrong in ("-0.2", "", None, True, [], {}, float("nan"), float("inf"), *[-0.2] * (word in POSITIVE)):
        description = copy.deepcopy(FULL)
        place = description
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = wrong
        with pytest.raises(ValueError, match=f"^bad: .*{word}: expected ") as refused:
            Scene("bad", description)
        assert len(str(refused.value)) <= 300
