"""A small scene in which something moves, and what of it captures must show."""

import numpy as np

import mock_server
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.sources import Request, View

DIALECTS = ("0.3.10", "M", "N1", "N2", "N3")
SIZE = 24
CENTER = (0.0, 0.0, 1.5)
THINGS = {
    "Box": {"solids": [{"box": [0.8, 0.5, 1.1], "at": [2.0, 0.5, 1.4]}]},
    "Pole": {"solids": [{"cylinder": [0.3, 3.0], "at": [1.5, -1.6, 1.5]}]},
    "Ball": {
        "solids": [{"sphere": 0.6, "at": [2.2, -0.6, 1.5]}],
        "moving": {"kind": "swing", "by": [0, 0.5, 0.3], "period_s": 1.3},
    },
}
SCENE = mock_server.Scene("yard", {"objects": THINGS})


def turned(place, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0):
    """An object's pose: yaw to the left, nose up, right side down, as rotations about the world's axes."""
    yaw, pitch, roll = np.radians([yaw_deg, -pitch_deg, roll_deg])
    about_z = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    about_y = [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    about_x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    return Pose(place, np.array(about_z) @ np.array(about_y) @ np.array(about_x))


MOVED = turned((1.8, 0.9, 1.7), 35.0, 20.0, -10.0)


def placed(poses, time_s=0.0):
    """The scene with objects at poses."""
    return SCENE.at(time_s, {name: (pose.rotation, pose.position) for name, pose in poses.items()})


def ahead(source, modes=("depth",)):
    """Requests of one view that has all objects in it, in the state of a source."""
    view = View(Pose.from_angles(CENTER), 90.0, SIZE, SIZE)
    return [Request(view, mode, source.state) for mode in modes]


def at_time(time_s):
    """The instant of the scene at a time."""
    rotation, place = SCENE.at(time_s).pose("Ball")
    return Instant({"Ball": Pose(place, rotation)}, time=time_s)


def serve(dialect="N1", scene=SCENE, frames_per_s=2000, **options):
    """Start a server of a scene; frames are so short that what takes some of them is fast."""
    return mock_server.serve(scene, dialect=dialect, size=(SIZE, SIZE), frames_per_s=frames_per_s, **options)
