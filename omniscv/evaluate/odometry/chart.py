"""The paper's charts of visual odometry: both errors frame by frame, and the trajectory from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from omniscv.evaluate.odometry.trajectory_errors import TrajectoryErrors
from omniscv.geometry import Array, Pose
from omniscv.storage.local import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRUE, _BOUND = "#d1495b", "#9aa3b2"
_COLORS = {"panorama": "#00798c", "fisheye": "#edae49", "mirror": "#6a4c93"}
_LEAST_DEG = 1e-3


def draw(
    runs: Mapping[tuple[str, str], TrajectoryErrors | None],
    truth: Sequence[Pose],
    times: Sequence[float],
    bound_deg: float,
    path: Path,
) -> Path:
    """Draw the errors of runs into a PNG of 1200 x 460 px; return its path.

    Args:
        runs: by camera and method, a line each, the second method of a camera dashed; None is left out.
        truth, times: the true trajectory, seconds.
        bound_deg: below which the paper's errors are.
        path: of the file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    position, orientation, above = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 1))
    above.plot(*_from_above(truth), "-", color=_TRUE, lw=4, alpha=0.5, label="truth")
    cameras = [camera for camera, _ in runs]
    for i, ((camera, method), errors) in enumerate(runs.items()):
        if errors is None:
            continue
        style: dict[str, Any] = {"ls": "--" if camera in cameras[:i] else "-", "color": _COLORS[camera]}
        at = [times[frame] for frame in errors.frames]
        for axes, values in ((position, errors.eps_t_deg), (orientation, errors.eps_theta_deg)):
            axes.plot(at, np.maximum(values, _LEAST_DEG), lw=1.6, **style)
        above.plot(*_from_above(errors.aligned), lw=1.2, label=f"{camera}, {method}", **style)
    _label(position, "position error $\\varepsilon_t$ (degrees)", bound_deg)
    _label(orientation, "orientation error $\\varepsilon_\\theta$ (degrees)", bound_deg)
    above.set(xlabel="x (m)", ylabel="y (m)", title="trajectory from above", aspect="equal")
    above.legend(fontsize=9, loc="center")
    above.grid(lw=0.4, alpha=0.5)
    with whole_file(path) as part:
        figure.savefig(part)
    return path


def _from_above(poses: Sequence[Pose]) -> Array:
    """(2, N) x and y."""
    return np.array([pose.position[:2] for pose in poses]).T


def _label(axes: Axes, title: str, bound_deg: float) -> None:
    axes.axhline(bound_deg, color=_BOUND, ls=":", lw=2)
    axes.annotate(
        f"the paper's errors are below {bound_deg:g} degrees",
        (0.02, bound_deg),
        xycoords=("axes fraction", "data"),
        xytext=(0, -5),
        textcoords="offset points",
        va="top",
        size=9,
    )
    axes.set(yscale="log", xlabel="time (s)", title=title, ylim=(None, 1.4 * bound_deg))
    axes.grid(lw=0.4, alpha=0.5, which="both")
