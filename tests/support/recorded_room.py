"""Images of the room of examples/blender/make_room.py; captures/living-room.sqlite holds their captures."""

import omniscv
from omniscv import Pose, cameras
from omniscv.geometry import cube_rotations

PLACE = (0.0, -0.35, 1.45)
TURNED = Pose.from_angles(PLACE, yaw_deg=60, pitch_deg=-8, roll_deg=5)
# captures are wider than faces by a border on each side
FACE_PX = 120
BORDER_PX = 4
MODES = ("lit", "object_mask", "depth", "normals")


def central(source, model, size, **parameters):
    camera = cameras.create(model, width=size[0], height=size[1], **parameters)
    return omniscv.render(camera, TURNED, source, MODES, strategy="cube", face_size=FACE_PX)


def panorama(source):
    return central(source, "equirectangular", (256, 128))


def fisheye(source):
    return central(source, "fisheye-equidistant", (144, 144), fov_deg=190.0)


def face(source, number):
    """A pinhole whose pixels have their centres where those of a face have theirs."""
    half = FACE_PX / 2
    camera = cameras.create("pinhole", width=FACE_PX, height=FACE_PX, fx=half, fy=half)
    pose = Pose(PLACE, cube_rotations()[number][1])
    return omniscv.render(camera, pose, source, MODES, strategy="cube", face_size=FACE_PX)


def noncentral(source):
    """A panorama on a circle, of faces at four places on it and of one in the middle."""
    camera = cameras.create("noncentral-panorama", width=64, height=32, radius=0.2)
    options = {"strategy": "exact", "face_size": 48, "viewpoints": 4}
    return omniscv.render(camera, TURNED, source, MODES[:3], **options)
