"""Episodes of an arm that reaches for boxes, seen by a fisheye in its hand and a panorama on the table.

Each step has the joints as its state, and the joints of the next step as its action::

    python examples/wrist/wrist.py arm --episodes 10 --steps 100
    omniscv dataset export arm --to lerobot
"""

import argparse
import sys

import mujoco
import numpy as np

import omniscv
from omniscv import dataset
from omniscv.errors import OmniscvError
from omniscv.sources.mujoco import from_model

FPS = 30
ARM = """
<mujoco model="arm">
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="2 2 .1" rgba=".6 .6 .55 1"/>
    <body name="table" pos=".45 0 .35"><geom type="box" size=".4 .5 .02" rgba=".5 .35 .2 1"/></body>
    <body name="shelf" pos="1.1 0 .6"><geom type="box" size=".05 .8 .6" rgba=".3 .4 .5 1"/></body>
    <body name="red" pos=".5 -.2 .41">
      <freejoint/><geom type="box" size=".04 .04 .04" rgba=".8 .2 .2 1"/>
    </body>
    <body name="blue" pos=".55 .2 .42">
      <freejoint/><geom type="cylinder" size=".04 .05" rgba=".2 .3 .8 1"/>
    </body>
    <body name="base" pos="0 0 .37">
      <geom type="cylinder" size=".07 .05" rgba=".2 .2 .2 1"/>
      <body name="upper" pos="0 0 .08">
        <joint name="turn" axis="0 0 1"/><joint name="lift" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 .3" size=".035" rgba=".9 .9 .9 1"/>
        <body name="lower" pos="0 0 .3">
          <joint name="bend" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 .25" size=".03" rgba=".9 .9 .9 1"/>
          <body name="hand" pos="0 0 .25">
            <joint name="tilt" axis="0 1 0"/>
            <geom type="box" size=".03 .04 .02" pos="0 0 .02" rgba=".3 .3 .3 1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
REST = np.array((0.0, 0.3, 0.9, 0.6))
"""Angles of the joints, rad, at which the hand looks down at the table."""
ON_THE_TABLE = omniscv.Pose.from_angles((0.75, -0.35, 0.6), yaw_deg=150)


def lenses(pixels):
    """Return the cameras, images of which are ``pixels`` high."""
    return {
        "wrist": omniscv.cameras.create("fisheye-equidistant", pixels, pixels, fov_deg=190),
        "table": omniscv.cameras.create("equirectangular", 2 * pixels, pixels),
    }


def reach(target, steps):
    """Return (steps, 4) angles from rest to a target and back, rad."""
    share = np.sin(np.linspace(0, np.pi, steps))[:, None]
    return REST + share * (target - REST)


def in_the_hand(data):
    """Return the pose of the wrist's camera: it looks along the hand's Z axis, its image's top along -X."""
    hand = data.body("hand")
    R_hand_c = np.array(((0, 1, 0), (-1, 0, 0), (0, 0, 1)))
    R_w_c = hand.xmat.reshape(3, 3) @ R_hand_c
    return omniscv.Pose(hand.xpos + R_w_c @ np.array((0, 0, 0.05)), R_w_c)


def main(out, episode_count, steps, pixels):
    """Render the episodes into the folder ``out``."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in ("turn", "lift", "bend", "tilt")]
    targets = np.random.default_rng(5).uniform(
        (-0.5, 0.5, 0.8, 0.4), (0.5, 0.9, 1.2, 0.8), (episode_count, 4)
    )
    with (
        from_model(model, data, name="arm") as source,
        dataset.episodes(out, lenses(pixels), fps=FPS, task="reach for a box", face_size=pixels) as episodes,
    ):
        for target in targets:
            path = reach(target, steps)
            for step, angles in enumerate(path):
                data.qpos[joints] = angles
                mujoco.mj_forward(model, data)
                with source.with_state(data) as now:
                    poses = {"wrist": in_the_hand(data), "table": ON_THE_TABLE}
                    episodes.add(now, poses, state=angles, action=path[min(step + 1, steps - 1)])
            episodes.end()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--pixels", type=int, default=256)
    given = parser.parse_args()
    try:
        main(given.out, given.episodes, given.steps, given.pixels)
    except OmniscvError as fault:
        sys.exit(f"omniscv: {fault}")
