"""``boxes``: every object that is seen, with its box in the image. ``STEM.truth.json``."""

from collections.abc import Mapping
from typing import Any

from omniscv.dataset.truths import Observation, Truth, no_options, register
from omniscv.truth.object_boxes import boxes
from omniscv.truth.oriented_boxes import truncated


def derive(observation: Observation, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the records of :func:`omniscv.truth.boxes.boxes`, with ``truncated`` where a box in space is
    known; there are no options."""
    no_options(options)
    image = observation.image
    records = boxes(
        observation.seen(),
        observation.instances,
        observation.classes,
        wrap=image.camera.wraps,
        depth=image.depth,
    )
    known = [record for record in records if record["name"] in observation.geometry.boxes]
    found = [observation.geometry.boxes[record["name"]] for record in known]
    for record, share in zip(known, truncated(found, image.camera, image.pose), strict=True):
        record["truncated"] = share
    return records


register(Truth("boxes", derive, needs=("object_mask",), check_options=no_options))
