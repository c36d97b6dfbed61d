"""The texts of each dialect, by the protocol reference and its supplement."""

import os
from typing import NamedTuple

import pytest
from support.expected_views import npy, png

from mock_server.dialects.common import OutputFolder

SIZE = (20, 16)
MODERN = ("M", "N1", "N2", "N3")
OLD_UNKNOWN = "error Can not find a handler for URI '{}'"
NEW_UNKNOWN = "error No handler found for URI '{}'"
SENSOR = "error Invalid sensor id"
ARGUMENT = "error Argument Invalid"
FILE = "error Invalid filename type, filename "
NOT_FOUND = "error Can not find object"
NO_BONES = "error No skeletal or poseable mesh component found"

# Commands that change nothing another one sees. None: the command is unknown.
REPLIES = {
    "L": [
        ("vget /unrealcv/version", "0.3.10"),
        ("vget /cameras", None),
        ("vset /cameras/spawn", None),
        ("vget /unrealcv/commands", None),
        ("vget /level/name", None),
        ("vbatch 3", None),
        ("vset /action/game/resume", None),
        ("vget /action/game/is_paused", None),
        ("vrun a b c d", None),
        ("vset /objects/spawn CubeActor Box", None),
        ("vset /object/Sofa/scale 1 1 1", None),
        ("vget /camera/0/fov", "error Unrecognized capture mode fov"),
        ("vget /camera/0/screenshot png", "error Unrecognized capture mode screenshot"),
        ("vget /camera/0/nothing x.png", "error Unrecognized capture mode nothing"),
        ("vget /camera/0/horizontal_fieldofview", "90.000"),
        ("vget /camera/0/location", "0.000 0.000 150.000"),
        ("vget /camera/0/rotation", "0.000 0.000 0.000"),
        ("vget /camera/3/rotation", "0.000 0.000 0.000"),
        ("vget /camera/0/pose", "0.000 0.000 150.000 0.000 0.000 0.000"),
        ("vget /actor/location", "0.000 0.000 150.000"),
        ("vget /camera/0/proj_matrix", ARGUMENT),
        ("vget /camera/3/location", "error Camera 3 can not be found."),
        ("vget /camera/3/lit png", "error Invalid camera id 3"),
        ("vget /camera/3/depth npy", "ok"),
        ("vget /camera/0/plane_depth npy", "ok"),
        ("vget /camera/0/vis_depth npy", "ok"),
        ("vset /camera/1/horizontal_fieldofview 60.0",
         "error Setting field of view is only supported for camera 0"),
        ("vget /object/Nothing/location", f"{NOT_FOUND} Nothing"),
        ("vset /object/Nothing/hide", f"{NOT_FOUND} Nothing"),
        ("vget /object/Nothing/color", "error Object Nothing not exist"),
        ("vget /object/Sofa/name", "Sofa"),
        ("vget /object/Sofa/location", "-241.25 -120.00 42.50"),
        ("vset /viewmode nothing", "error Can not set ViewMode to nothing"),
        ("vset /action/eyes_distance 20", "ok"),
        ("vrun r.EyeAdaptationQuality 0", "ok"),
        ("vexec Nobody Jump", "error Can not find actor with id 'Nobody'"),
        ("vexec Sofa Jump", "error Fail to execute the function 'Jump' of Sofa"),
        ("vget /unrealcv/echo word", "word"),
    ],
    "M": [
        ("vget /unrealcv/version", "0.3.10"),
        ("nonsense", None),
        ("vget /unrealcv/commands", None),
        ("vget /level/name", "four-wall"),
        ("vset /camera/0/ortho_width 100", "ok"),
        ("vset /camera/0/projection_type orthographic", "ok"),
        ("vget /camera/0/horizontal_fieldofview", None),
        ("vget /cameras", "PawnSensor "),
        ("vget /camera/0/fov", "90.000000"),
        ("vget /camera/0/size", ARGUMENT),
    ],
    "N1": [
        ("vget /unrealcv/version", "1.0.1"),
        ("vget /unrealcv/echo word", "word"),
        ("vget /unrealcv/echo a\nb", "a"),  # a command ends at a line feed, and at a null byte
        ("vget /unrealcv/echo a\0b", "a"),
        ("vget /scene/name", "four-wall"),
        ("vget /cameras", "PawnSensor "),
        ("vget /unrealcv/commands", None),
        ("vget /camera/0/horizontal_fieldofview", None),
        ("vget /camera/0/pose", None),
        ("vget /camera/0/lit", None),
        ("vget /camera/0/plane_depth npy", None),
        ("vget /camera/0/vis_depth npy", None),
        ("vget /camera/0/optical_flow png", None),
        ("vget /camera/-1/location", None),
        ("vset /camera/1/location 1 2", None),
        ("vset /camera/1/location 1e-05 2 3", None),
        ("vset /camera/1/location 5. 2 3", None),
        ("vset /camera/1/location nan 2 3", None),
        ("vget /object/Sofa/name", None),
        ("VGET /cameras", None),
        ("vcmd x", None),
        ("DisableAllScreenMessages", None),
        ("", None),
        ("vget /viewmode   ", "lit"),  # templates are not anchored, and may be followed by spaces
        ("xx vget /viewmode", "lit"),
        ("vget /camera//fov", "90.000000"),
        ("vget /camera/7/location", SENSOR),
        ("vset /camera/7/location 1 2 3", SENSOR),
        ("vget /camera/7/lit png", SENSOR),
        ("vget /camera/7/depth npy", SENSOR),
        ("vget /camera/99999999999999999999999/lit png", SENSOR),
        ("vset /camera/7/moveto 1 2 3", SENSOR),
        ("vget /camera/7/fov", ARGUMENT),
        ("vget /camera/7/size", ARGUMENT),
        ("vget /camera/0/lit jpg", f"{FILE}jpg"),
        ("vget /camera/0/lit ", FILE),
        ("vget /camera/0/depth png", f"{FILE}png"),
        ("vget /camera/0/depth x.exr", f"{FILE}x.exr"),
        ("vget /object/Nothing/location", NOT_FOUND),
        ("vget /object/Nothing/color", NOT_FOUND),
        ("vset /object/Nothing/hide", NOT_FOUND),
        ("vget /object//color", NOT_FOUND),
        ("vget /object/Sofa/bounds", "-287.50 -223.00 0.00 -195.00 -17.00 85.00"),  # its Y is mirrored
        ("vset /objects/spawn Cube MyCube", "error Can not find a class with name 'Cube'"),
        ("vset /viewmode Nothing", "error Can not set ViewMode to nothing"),
        ("vset /action/eyes_distance 3.0", "error Not Implemented"),
        ("vset /objects/spawn CubeActor Far 1.0 2.0 3.0", None),
        ("vexec Nobody Jump", "error Can not find actor with id 'Nobody'"),
        ("vexec Sofa Jump 1 2", "error Fail to execute the function 'Jump 1 2' of Sofa"),
        ("vbp Sofa Jump 1 2", ARGUMENT),
        ("vget /persistent_level/id", "PersistentLevel"),
        ("vget /persistent_level/level_script_actor/id", "four-wall_C_0"),
        ("vrun r.Tonemapper.Quality 1", "ok"),
        ("vrun setres 640x480w", "ok"),
        ("vrun a b c d e f", "ok"),
        ("vbatch 3", "ok"),
        ("vset /action/input/disable", "ok"),
        ("vget /action/game/is_paused", "false"),
    ],
    "N2": [
        ("vget /unrealcv/version", "1.0.1"),
        ("nonsense", None),
        ("vget /unrealcv/commands", None),
        ("vget /camera/0/horizontal_fieldofview", None),
        ("vget /cameras", "PawnSensor "),
        ("xx vget /viewmode", None),
        ("vrun X", "error Unrecognised alias 'X'"),
        ("vrun r.MotionBlurQuality 0", "ok"),
        ("vcmd DisableAllScreenMessages", "ok"),
        ("vget /object/Nothing/location", "error Cannot find object"),
        ("vget /object/Nothing/color", "error Cannot find object"),
        ("vget /object/Sofa/uclass_name", "StaticMeshActor"),
        ("vset /camera/0/exposure_method MANUAL", "ok"),
        ("vset /camera/0/exposure_method true", "error Can not support exposure method true, "
         "available options are histogram, basic and manual"),
        ("vset /camera/0/exposure_bias 1.5", "ok"),
        ("vset /camera/0/motion_blur 0 0 0 0", "ok"),
        ("vset /camera/7/exposure_bias 1.5", ARGUMENT),
        ("vset /camera/7/reflection lumen", ARGUMENT),
        ("vget /camera/7/lit png", SENSOR),
        ("vbp Cow Jump", "error Can not find actor with id 'Cow'"),
    ],
    "N3": [
        ("vget /unrealcv/version", "1.1.0"),
        ("nonsense", None),
        ("vget /cameras/ids", None),
        ("vexec Sofa Jump 1 2", "error Fail to execute the function 'Jump 1 2' of Sofa"),
        ("vget /camera/CID-Actor-00/fov", None),
        ("vget /camera/0/lit_shared", None),
        ("vbatch 1", "ok"),
        ("vrun DisableAllScreenMessages", "ok"),
        ("vset /camera/7/ortho_width 100", SENSOR),
        ("vset /camera/7/projection_type perspective", SENSOR),
        ("vset /camera/0/projection_type fish", "error Can not support camera mode fish, "
         "available options are perspective and orthographic"),
        ("vget /camera/0/cine/enabled", "0"),
        ("vget /camera/99/cine", ARGUMENT),
        ("vset /camera/0/cine/focus_mode far 0 0 0",
         "error Focus mode must be manual, tracking, disable, none, or do_not_override"),
        ("vget /object/Sofa/bones", NO_BONES),
        ("vget /object/Sofa/bones hand world", NO_BONES),
        ("vget /object/Sofa/bones hand space", "error Bone space must be component or world"),
        ("vget /object/Nothing/bones", "error Cannot find object"),
        ("vset /objects/spawn Sphere 0 0 0", "error Can not find a class with name 'Sphere'"),
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def client_of(load_scene, serve_for_module):
    return {name: serve_for_module(load_scene("four-wall"), dialect=name, size=(8, 8)) for name in REPLIES}


@pytest.mark.parametrize(
    ("dialect", "command", "reply"), [(name, *row) for name, rows in REPLIES.items() for row in rows]
)
def test_replies(client_of, dialect, command, reply):
    unknown = NEW_UNKNOWN if dialect in ("N2", "N3") else OLD_UNKNOWN
    assert client_of[dialect].text(command) == (unknown.format(command.strip()) if reply is None else reply)


class Same(NamedTuple):
    command: str


class Talk(NamedTuple):
    about: str
    dialects: str
    rows: list
    scene: str = "four-wall"


def each(old, new):
    """A reply of M and N1, and another one of N2 and N3."""
    return {"M": old, "N1": old, "N2": new, "N3": new}


BOX = "-50.00 -50.00 -50.00 50.00 50.00 50.00"
ROTATED = "-50.00 -25.00 -100.00 50.00 25.00 100.00"
CAMERA = [("vset /cameras/spawn", "FusionCameraActor_0")]
PAUSED = [("vset /action/game/pause", "ok")]
SETTLE = [("vget /unrealcv/echo settle", "settle")] * 3
"""Three round trips: poses and pictures follow."""

TALKS = [
    Talk("cameras are numbered as they are spawned", "N1", [
        *CAMERA,
        ("vset /cameras/spawn", "FusionCameraActor_1"),
        ("vget /cameras", "PawnSensor FusionCameraSensor FusionCameraSensor "),
        ("vset /camera/1/moveto 1 2 3", "error MoveTo only supports the player camera with id 0"),
    ]),
    Talk("values of cameras are printed as in C", "N1", [
        *CAMERA,
        ("vset /camera/1/size 40 30", "ok"),
        ("vset /camera/1/fov 75.5", "ok"),
        ("vset /camera/1/location +1.23456 -.5 7", "ok"),
        ("vset /camera/1/rotation 10.0 30.0 5.0", "ok"),
        ("vget /camera/1/location", "1.235 -0.500 7.000"),
        ("vget /camera/1/rotation", "10.000 30.000 5.000"),
        ("vget /camera/1/fov", "75.500000"),
        ("vget /camera/1/size", "40 30"),
    ]),
    Talk("M sets a size that it cannot tell", "M", [
        ("vset /camera/0/size 20 10", "ok"),
        ("vget /camera/0/lit png", lambda reply: png(reply).shape == (10, 20, 4)),
    ]),
    Talk("N3 clamps fields of view in silence", "N3", [
        *CAMERA,
        ("vset /camera/1/fov 200", "ok"), ("vget /camera/1/fov", "179.000000"),
        ("vset /camera/1/fov 0.5", "ok"), ("vget /camera/1/fov", "1.000000"),
        ("vset /camera/1/fov 75.5", "ok"), ("vget /camera/1/fov", "75.500000"),
    ]),
    Talk("cine settings are clamped and reported", "N3", [
        ("vset /camera/0/cine/lens_settings 5 500 1.2 32 20 3 2", "ok"),
        ("vset /camera/0/cine/lens 1 200", "ok"),
        ("vset /camera/0/cine/focus_mode TRACKING 1 2 3", "ok"),
        ("vset /camera/0/cine/focus_tracking Sofa 1 2 3", "ok"),
        ("vset /camera/0/cine/crop 1.5 0.1 1 0", "ok"),
        ("vset /camera/0/cine/filmback 36 24 0 0", "ok"),
        ("vset /camera/0/cine/focus 100", "ok"),
        ("vset /camera/0/cine/near_clip 0 10", "ok"),
        ("vset /camera/0/cine/exposure 100 120 0", "ok"),
        ("vget /camera/0/cine", lambda reply: all(part in reply for part in (
            b'"enabled": true', b'"focal_length_mm": 5.0', b'"aperture_fstop": 32.0',
            b'"squeeze_factor": 2.0', b'"diaphragm_blade_count": 4', b'"mode": "tracking"',
            b'"tracking_actor": "Sofa"', b'"overscan": 0.1', b'"crop_overscan": true', b'"iso": 100.0',
        ))),
    ]),
    Talk("the controller limits the player's camera", "L M N1 N2 N3", [
        row for rotation, read in (
            ("-90 -30 95", "270.100 330.000 89.900"),
            ("90 720.5 -100", "89.900 0.500 270.100"),
            ("-30 0 0", "330.000 0.000 0.000"),
        ) for row in [
            (f"vset /camera/0/rotation {rotation}", "ok"), *SETTLE, ("vget /camera/0/rotation", read)]
    ]),
    Talk("the player's camera stays while the game is paused", "M N1 N2 N3", [
        *CAMERA, *PAUSED,
        ("vset /camera/0/location 50 0 150", "ok"),
        ("vset /camera/1/location 50 0 150", "ok"),
        *SETTLE,
        ("vget /camera/0/location", "0.000 0.000 150.000"),
        ("vget /camera/1/location", "50.000 0.000 150.000"),
        ("vset /action/game/resume", "ok"),
        *SETTLE,
        ("vget /camera/0/location", "50.000 0.000 150.000"),
    ]),
    Talk("the screenshot is the player's", "M N1 N2 N3", [
        ("vget /screenshot gif", f"{FILE}gif"),
        ("vset /viewmode object_mask", "ok"),
        ("vget /screenshot png", Same("vget /camera/0/object_mask png")),
    ]),
    Talk("L moves the pawn at once, by any camera's number", "L", [
        ("vset /camera/5/location 10 20 130", "ok"),
        ("vget /camera/0/location", "10.000 20.000 130.000"),
        ("vset /camera/0/pose 1 2 120 0 15 0", "ok"),
        ("vget /actor/location", "1.000 2.000 120.000"),
        ("vset /camera/0/pose 0 0 150 0 0 0", "ok"),
    ]),
    Talk("objects are spawned and destroyed", "M N1 N2 N3", [
        ("vset /objects/spawn CubeActor Box", "Box"),
        ("vget /objects", lambda reply: reply.endswith(b" Box ")),
        ("vset /objects/spawn CubeActor Box", each(
            "error Failed to spawn Box, object exsit.", "error Failed to spawn Box, object exists.")),
        ("vset /objects/spawn CubeActor", "CubeActor_1"),
        ("vset /objects/spawn_cube", each("ok", "CubeActor_2")),
        ("vset /objects/spawn_cube Dice", each("ok", "Dice")),
        ("vget /object/Dice/location", each(NOT_FOUND, "0.000 0.000 0.000")),
        ("vget /object/Box/bounds", BOX),
        ("vget /object/Box/uclass_name", each("Actor", "CubeActor")),
        ("vget /object/Box/mobility", "Movable"),
        ("vset /object/Box/destroy", "ok"),
        ("vget /object/Box/location", each(NOT_FOUND, "error Cannot find object")),
        ("vset /objects/spawn CubeActor Box", "Box"),
    ], "workshop"),
    Talk("N3 spawns objects in their place", "N3", [
        ("vset /objects/spawn_cube Box 0 0 100", "Box"),
        ("vset /objects/spawn_cube Box 0 0 100", "error Failed to spawn Box, object exists."),
        ("vget /object/Box/location", "0.000 0.000 100.000"),
        ("vset /objects/spawn CubeActor Dice 10 -20 30.5", "Dice"),
        ("vget /object/Dice/location", "10.000 -20.000 30.500"),
        ("vset /objects/spawn_cube 1 2 3", "CubeActor_2"),
        ("vget /object/CubeActor_2/location", "1.000 2.000 3.000"),
        ("vget /object/Box/uclass_name", "CubeActor"),
    ]),
    Talk("scales are along the object's own axes, and may be 0", "M N1 N2 N3", [
        *CAMERA, *PAUSED,
        ("vget /object/Bench/scale", "1.000 1.000 1.000"),
        ("vset /objects/spawn CubeActor Box", "Box"),
        ("vset /object/Box/scale 0.5 1.0 2.0", "ok"),
        ("vget /object/Box/scale", "0.500 1.000 2.000"),
        ("vget /object/Box/bounds", "-25.00 -50.00 -100.00 25.00 50.00 100.00"),
        ("vset /object/Box/rotation 0 90 0", "ok"),
        ("vget /object/Box/bounds", ROTATED),
        ("vset /object/Box/scale 0 0 0", "ok"),
        ("vset /object/Lamp/scale 0 0 0", "ok"),
        ("vget /object/Box/bounds", "-0.00 -0.00 -0.00 0.00 0.00 0.00"),
        ("vget /camera/1/depth npy", lambda reply: npy(reply).shape == SIZE[::-1]),
        ("vset /object/Box/scale 1 1 1", "ok"),
        ("vget /object/Box/bounds", BOX),
    ], "workshop"),
    Talk("a name that is taken is not given again", "M N1 N2 N3", [
        ("vset /object/Crate/name Bench",
         "error Renaming an object to overwrite an existing object is not allowed, Bench"),
        ("vset /object/Crate/name Crate", "The name has already been set"),
    ], "workshop"),
    Talk("objects are renamed, coloured modulo 256 and destroyed", "N1", [
        ("vset /object/Sofa/color 300 5 511", "ok"),
        ("vget /object/Sofa/color", "(R=44,G=5,B=255,A=255)"),
        ("vset /object/Sofa/name Couch", "ok"),
        ("vget /objects", lambda reply: b" Couch " in reply),
        ("vget /object/Sofa/color", NOT_FOUND),
        ("vset /object/Couch/destroy", "ok"),
        ("vget /objects", lambda reply: b"Couch" not in reply),
    ]),
]  # fmt: skip


TALKING = {f"{talk.about}-{name}": (talk, name) for talk in TALKS for name in talk.dialects.split()}


@pytest.mark.parametrize(("talk", "dialect"), TALKING.values(), ids=TALKING)
def test_conversations(talk, dialect, start, open_raw):
    client = open_raw(start(talk.scene, dialect=dialect, size=SIZE))
    for command, expected in talk.rows:
        reply = client.ask(command)
        expected = expected[dialect] if isinstance(expected, dict) else expected
        if isinstance(expected, Same):
            assert reply == client.ask(expected.command)
        elif callable(expected):
            assert expected(reply), (command, reply[:200])
        else:
            assert (command, reply.decode()) == (command, expected)


@pytest.mark.timeout(30)
def test_files_are_not_written_into_a_named_pipe(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    OutputFolder(tmp_path).write("a.png", b"x")
    OutputFolder(tmp_path).write("b.png", b"x")
    assert (tmp_path / "a.png").is_fifo()
    assert (tmp_path / "b.png").read_bytes() == b"x"
