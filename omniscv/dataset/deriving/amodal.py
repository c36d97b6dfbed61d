"""``amodal``: how much of every object is seen, and what its mask would be alone. ``STEM.truth.json``.

It renders the image's masks again with all but some objects hidden: those that cannot hide each other are
shown together, so a furnished room takes two to four such images. In a live engine each takes the captures of
an object mask, and two commands for every object.
"""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from omniscv.arguments import fields, one_of
from omniscv.compose.renderer import Renderer
from omniscv.dataset.truths import Observation, Truth, register
from omniscv.errors import ArgumentError
from omniscv.truth.object_boxes import Labels
from omniscv.truth.visibility import amodal, apart, centers_ball

Kind = Literal["boxes", "masks"]

_OPTIONS = {"kind": partial(one_of, words=get_args(Kind))}


def derive(observation: Observation, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the records of :func:`omniscv.truth.visibility.amodal`.

    Walls, floor and ceiling of the room, and objects whose class is stuff, have none. The option ``kind`` is
    ``boxes`` (if left out) or ``masks``.

    Raises:
        ArgumentError: offline, or a source that cannot hide objects.
    """
    kind = _options(options).get("kind", "boxes")
    renderer = observation.renderer
    if renderer is None:
        raise ArgumentError("expected a source that can hide objects, got none; make the dataset with it")
    image = observation.image
    boxes = observation.geometry.boxes
    center_w, radius = centers_ball(np.asarray(image.centers_w))
    groups = apart(_things(observation), boxes, center_w, radius)
    show = partial(_shown, observation, renderer)
    labels, names = observation.seen(), observation.instances
    return amodal(labels, names, groups, show, wrap=image.camera.wraps, masks=kind == "masks")


def _options(options: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = fields("", options, _OPTIONS)
    return found


def _things(observation: Observation) -> list[str]:
    """The objects that are seen, or may be: an analytic scene's boxes are those of its own objects only."""
    labels, room = observation.seen(), observation.geometry.room
    seen = set(np.flatnonzero(np.bincount(labels.ravel())).tolist())
    surfaces = () if room is None else room.surfaces
    found = []
    for name, instance in sorted(observation.instances.items()):
        box = observation.geometry.boxes.get(name)
        of = None if observation.classes is None else observation.classes.of(name)
        may_be = instance in seen or (box is not None and box.source == "scene")
        if may_be and name not in surfaces and not (of and of.stuff):
            found.append(name)
    return found


def _shown(observation: Observation, renderer: Renderer, names: Iterable[str]) -> Labels:
    """(H, W) ids of the image with nothing but these objects."""
    image, instances = observation.image, observation.instances
    others = set(renderer.source.objects().names()) - set(names)
    with renderer.source.without(sorted(others)) as source:
        alone = renderer.of(source).render(image.camera, image.pose, ("object_mask",), image.options)
    ranks = () if alone.objects is None else alone.objects.names()
    ids = np.array([0, *(instances.get(name, 0) if name in names else 0 for name in ranks)], np.uint16)
    found: Labels = ids[alone["labels"]]
    return found


register(Truth("amodal", derive, needs=("object_mask",), captures=True, check_options=_options))
