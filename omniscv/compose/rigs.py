"""Images of a rig's cameras, of captures that they share."""

from collections.abc import Sequence
from typing import Unpack

from omniscv.arguments import shown
from omniscv.cameras.rig import Rig
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer, options_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.planning import RenderKeywords
from omniscv.progress import Report
from omniscv.sources.base import Source


def render_rig(
    rig: Rig,
    pose: Pose | Trajectory,
    source: Source,
    modes: Sequence[str] = ("lit",),
    *,
    time: float | None = None,
    progress: Report | None = None,
    **options: Unpack[RenderKeywords],
) -> dict[str, OmniImage]:
    """Compose the images of all cameras of a rig; what several of them need is captured once.

    Args:
        rig: the cameras.
        pose: of the rig, world frame; or its timed poses, along which time offsets move the cameras.
        source, modes: of which captures, and which modalities.
        time: the rig's, seconds, where poses are timed.
        progress: called with how far the images have come, after each viewpoint.
        options: the fields of :class:`omniscv.RenderOptions`.

    Returns:
        The images by the cameras' names.

    Raises:
        OmniscvError: as :func:`omniscv.render` and :meth:`Rig.poses`.
    """
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig: expected a Rig, got {shown(rig)}")
    poses = rig.poses(pose, time)
    shots = [(mounted.camera, poses[name]) for name, mounted in rig.cameras.items()]
    images = Renderer(source).render_together(shots, modes, options_of(options), progress=progress)
    return dict(zip(rig.cameras, images, strict=True))
