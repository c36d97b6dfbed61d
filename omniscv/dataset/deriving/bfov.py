"""``bfov``: boxes on the sphere of directions around every object that is seen. ``STEM.truth.json``."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from omniscv.cameras import Camera
from omniscv.dataset.truths import Observation, Truth, no_options, register
from omniscv.geometry import Array
from omniscv.truth.spherical_fit import bfovs


def derive(observation: Observation, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return by object ``instance_id``, ``name``, ``bfov`` and, rotated, ``rbfov``, records of
    :class:`omniscv.truth.spherical.SphericalBox`; there are no options."""
    no_options(options)
    camera = observation.image.camera
    named = {instance: name for name, instance in observation.instances.items()}
    found = bfovs(observation.seen(), partial(_directions, camera), camera.wraps)
    return [
        {
            "instance_id": instance,
            "name": named[instance],
            "bfov": upright.to_dict(),
            "rbfov": rotated.to_dict(),
        }
        for instance, (upright, rotated) in found.items()
        if instance in named
    ]


def _directions(camera: Camera, rows: Array, columns: Array) -> Array:
    return camera.unproject(np.stack([columns + 0.5, rows + 0.5], axis=-1)).directions


register(Truth("bfov", derive, needs=("object_mask",), check_options=no_options))
