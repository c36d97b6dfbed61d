"""From an image to the records of its truths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omniscv.arguments import within
from omniscv.dataset import truths
from omniscv.dataset.recipe import kind_of
from omniscv.dataset.truths import Observation


def derive(
    observation: Observation,
    wanted: Mapping[str, Mapping[str, Any]],
    before: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return what is derived of an image: by kind, the content of ``STEM.KIND.json``.

    Args:
        observation: the image.
        wanted: truths by name, with their options.
        before: what was derived of it before, to which this is added.

    Raises:
        OmniscvError: as a truth raises, with the key and its name before it.
    """
    found: dict[str, Any] = {kind: dict(record) for kind, record in (before or {}).items()}
    for name, options in wanted.items():
        truth = truths.get(name)
        with within(f"{observation.key}: truth.{name}"):
            record = truth.derive(observation, options)
        if truth.file == "truth.json":
            found.setdefault("truth", {})[name] = record
        else:
            found[kind_of(truth)] = record
    return found
