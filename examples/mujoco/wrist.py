"""A robot arm's wrist camera: a fisheye of 190 degrees and a panorama, with labels, depth and normals.

The model is robosuite's table with a Panda, made of its XML alone (MIT), without robosuite's old NumPy::

    pip install omniscv[mujoco]
    pip install --no-deps robosuite==1.5.2
    python examples/mujoco/wrist.py out/wrist
"""

import importlib.util
import sys
from pathlib import Path

import mujoco
import numpy as np

import omniscv
from omniscv.sources.mujoco import from_model

ANGLES = (0, 0.3, 0, -1.9, 0, 2.2, 0.8)  # of the joints, radians: above the table
MODES = ("lit", "object_mask", "depth", "normals")


def workspace():
    """Return robosuite's table with a Panda behind it, as MuJoCo's model and data."""
    package = importlib.util.find_spec("robosuite")
    if package is None or package.origin is None:
        sys.exit("wrist.py: expected robosuite's models; pip install --no-deps robosuite==1.5.2")
    assets = Path(package.origin).parent / "models" / "assets"
    world = mujoco.MjSpec.from_file(str(assets / "arenas" / "table_arena.xml"))
    panda = mujoco.MjSpec.from_file(str(assets / "robots" / "panda" / "robot.xml"))
    for name, shape, size, at in (
        ("box", mujoco.mjtGeom.mjGEOM_BOX, (0.04, 0.04, 0.06), (0.05, -0.15, 0.86)),
        ("can", mujoco.mjtGeom.mjGEOM_CYLINDER, (0.033, 0.06, 0), (0.1, 0.15, 0.86)),
        ("orange", mujoco.mjtGeom.mjGEOM_SPHERE, (0.04, 0, 0), (-0.05, 0.05, 0.84)),
    ):
        body = world.worldbody.add_body(name=name, pos=at)
        color = {"box": (0.2, 0.4, 0.8, 1), "can": (0.8, 0.1, 0.1, 1), "orange": (1, 0.5, 0, 1)}[name]
        body.add_geom(type=shape, size=size, rgba=color, group=1)
    world.attach(panda, prefix="panda/", frame=world.worldbody.add_frame(pos=(-0.56, 0, 0.8)))
    model = world.compile()
    data = mujoco.MjData(model)
    data.qpos[:7] = ANGLES
    mujoco.mj_forward(model, data)
    return model, data


def wrist(data):
    """Return the pose of a camera in front of the hand: MuJoCo's axes of the hand are ours (z forward)."""
    hand = data.body("panda/right_hand")
    R_w_c = hand.xmat.reshape(3, 3)
    return omniscv.Pose(hand.xpos + R_w_c @ np.array((0, 0, 0.06)), R_w_c)


def main(out):
    model, data = workspace()
    fisheye = omniscv.cameras.create("fisheye-equidistant", width=512, height=512, fov_deg=190)
    panorama = omniscv.cameras.create("equirectangular", width=1024, height=512)
    with from_model(model, data, name="workspace", groups="12") as source:
        omniscv.render(fisheye, wrist(data), source, MODES).save(out, "wrist")
        beside = omniscv.Pose.from_angles((0.1, -0.7, 1.4), yaw_deg=90, pitch_deg=-10)
        omniscv.render(panorama, beside, source, MODES).save(out, "room")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/wrist")
