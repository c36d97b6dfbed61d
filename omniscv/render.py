"""The whole road in one call: camera, rays, plan, source, compose, image."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from omniscv.cameras import Camera
from omniscv.captures.source import Source
from omniscv.captures.view import MODES
from omniscv.compose import Composer
from omniscv.compose.reproject import DEFAULT_ERROR_PX, reproject
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.output.image import OmniImage
from omniscv.plan import make_plan
from omniscv.plan.make import FEW


def render(
    camera: Camera,
    pose: Pose,
    source: Source,
    modes: Sequence[str] = ("lit",),
    *,
    strategy: str = "auto",
    viewpoints: int | None = None,
    face_size: int | str = "auto",
    filter: str = "auto",
    max_error_px: float | None = None,
    composer: Composer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> OmniImage:
    """Composes an omnidirectional image and its ground truth from captures.

    Args:
        camera: the model and its size.
        pose: where the camera is, world frame.
        source: where captures come from: live, recorded or recording.
        modes: any of lit, object_mask (with labels), depth, normal.
        strategy: which views are captured: ``cube``, ``faces``, ``strips``, ``adaptive`` or ``auto``,
            the cheapest that the source can do (``omniscv.plan``).
        viewpoints: optical centres of a non-central camera; one per column or ring if not given.
        face_size: px of a 90 degree face; ``auto`` is the smallest that loses no detail.
        filter: ``nearest``, ``bilinear``, ``bicubic``, ``area`` or ``auto``, chosen per mode.
        max_error_px: the error that ``adaptive`` may make, in output pixels.
        composer: keeps rays and maps between calls; give the same one for a sequence of images.
        progress: called with (captures done, captures in all).

    Returns:
        The image; layers of modes that were not asked for are None.

    Raises:
        ArgumentError: an unknown mode, strategy or filter, or arguments that exclude each other.
        SourceError, RecordError: a capture could not be had.
    """
    modes = tuple(modes)
    if not modes or len(set(modes)) != len(modes) or not set(modes) <= set(MODES):
        raise ArgumentError(f"modes: expected some of {', '.join(MODES)}, each once; got {list(modes)!r}")
    if max_error_px is not None and strategy not in FEW:
        raise ArgumentError(f"max_error_px: expected strategy {' or '.join(FEW)}, got {strategy!r}")
    plan = make_plan(
        camera,
        pose,
        source.capabilities,
        strategy=strategy,
        viewpoints=viewpoints,
        face_size=face_size,
        recorded=source.recorded_views(),
    )
    if plan.strategy in FEW:
        error_px = DEFAULT_ERROR_PX if max_error_px is None else max_error_px
        layers = reproject(plan, source, modes, max_error_px=error_px, filter=filter, progress=progress)
    else:
        layers = (composer or Composer()).compose(plan, source, modes, filter=filter, progress=progress)
    return OmniImage(camera=camera, pose=pose, layers=layers)
