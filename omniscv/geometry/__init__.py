"""Poses, frames, perspective projection, trajectories. Knows no camera model and no source."""

from omniscv.geometry.pose import R_LEVEL, Array, Pose, UnrealPose, cube_rotations

__all__ = ["R_LEVEL", "Array", "Pose", "UnrealPose", "cube_rotations"]
