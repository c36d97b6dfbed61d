"""Where objects are: the poses of those whose poses are known, for the flow of objects that move."""

from collections.abc import Mapping
from typing import Any

from omniscv.dataset.truths import Observation, Truth, no_options, register


def derive(observation: Observation, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return by name the position (metres) and rotation of objects, world frame; it has no options."""
    no_options(options)
    return {name: pose.to_dict() for name, pose in sorted(observation.object_poses.items())}


register(Truth("poses", derive, check_options=no_options))
