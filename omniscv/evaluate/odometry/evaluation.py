"""Visual odometry on images of a flight, scored by the true poses: the paper's evaluation with OpenVSLAM.

COLMAP reconstructs panoramas and fisheyes. The odometry of ``visual_odometry.py`` uses the
bearings of these, and of a camera with a mirror, which COLMAP does not have. Cameras without a single optical
centre are left out: both methods assume that all rays of an image start at one point.

Option ``trajectory``: a TUM, KITTI or EuRoC file of poses in place of the loop in the mock's room.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.evaluate.odometry import chart as odometry_chart
from omniscv.evaluate.odometry import sequence, visual_odometry
from omniscv.evaluate.odometry.features import detect
from omniscv.evaluate.odometry.structure_from_motion import load_pycolmap, reconstruct
from omniscv.evaluate.odometry.trajectory_errors import TrajectoryErrors, path_length, rms, trajectory_errors
from omniscv.evaluate.registry import Settings
from omniscv.evaluate.report import Figure, Report
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory, read_trajectory, write_tum
from omniscv.planning import densities
from omniscv.sources.registry import open_source
from omniscv.storage.local import whole_file

OPTIONS = frozenset({"trajectory"})

SOURCE = "scene://four-wall"

PAPER_DEG = 8.0
"""Both errors of the paper are less, over the whole flight."""

_FEATURES = 2000
_LIMIT_PX = 1.5

Method = Callable[[Sequence[Path], Camera], dict[int, Pose]]


def odometry(images: Sequence[Path], camera: Camera) -> dict[int, Pose]:
    """Return the poses of images of a central camera by index, up to where it is lost."""
    step_rad = float(np.nanmedian(densities.steps(camera.unproject().directions)))
    greys = (np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in images)
    features = [detect(grey, camera, _FEATURES) for grey in greys]
    return visual_odometry.estimate(features, _LIMIT_PX * step_rad)


RUNS: Mapping[tuple[str, str], Method] = {
    ("panorama", "COLMAP"): reconstruct,
    ("panorama", "bearings"): odometry,
    ("fisheye", "COLMAP"): reconstruct,
    ("fisheye", "bearings"): odometry,
    ("mirror", "bearings"): odometry,
}
"""By camera and name of the method."""


def evaluate(settings: Settings) -> Report:
    """Render the flight, estimate it by each method, and score it.

    Images and trajectories stay in ``settings.out / "odometry"``, for other programs to try.

    Raises:
        ArgumentError: a trajectory that cannot be read.
        OmniscvError: no pycolmap; of the source.
    """
    pycolmap = load_pycolmap()
    count, width, edge = (20, 768, 512) if settings.quick else (60, 1024, 640)
    trajectory = _flight(settings, count)
    rig, folder = sequence.eyes(width, edge), settings.out / "odometry"
    total = len(trajectory) * (1 + len(RUNS))
    with open_source(settings.source or SOURCE) as source:
        images = sequence.shoot(rig, trajectory, source, folder, lambda done: settings.progress(done, total))
    written = [_write(folder / "truth.tum", trajectory)]
    scores: dict[tuple[str, str], TrajectoryErrors | None] = {}
    for i, ((name, method), estimate) in enumerate(RUNS.items(), start=1):
        camera, T_cam_rig = rig.cameras[name].camera, rig.cameras[name].pose.inverse()
        found = {frame: pose @ T_cam_rig for frame, pose in estimate(images[name], camera).items()}
        scored = scores[name, method] = _scored(trajectory, found)
        if scored is not None:
            written.append(_write(folder / f"{name}-{method.lower()}.tum", _estimated(trajectory, scored)))
        settings.progress((1 + i) * len(trajectory), total)
    path = settings.out / "odometry.png"
    chart = odometry_chart.draw(scores, trajectory, _times(trajectory), PAPER_DEG, path)
    about = {
        "source": settings.source or SOURCE,
        "cameras": {name: mounted.camera.to_dict() for name, mounted in rig.cameras.items()},
        "poses": len(trajectory),
        "path_m": path_length(trajectory),
        "origin of eps_t": [0.0, 0.0, 0.0],
        "pycolmap": pycolmap.__version__,
        "seed": 0,
    }
    figures = [each for run, errors in scores.items() for each in _figures(run, trajectory, errors)]
    rows = [row for run, errors in scores.items() for row in _rows(run, trajectory, errors)]
    return Report(figures, rows, about, [chart, *written])


def _flight(settings: Settings, count: int) -> Trajectory:
    """The loop of so many poses, or those of a file; ``quick``: not more of these either."""
    path = settings.options.get("trajectory")
    if path is None:
        return sequence.flight(count)
    read = read_trajectory(Path(path))
    return read[:: -(-len(read) // count)] if settings.quick else read


def _times(trajectory: Trajectory) -> tuple[float, ...]:
    """Seconds; numbers of the poses where they have no times."""
    return trajectory.times or tuple(map(float, range(len(trajectory))))


def _scored(truth: Trajectory, found: Mapping[int, Pose]) -> TrajectoryErrors | None:
    """The errors; None where too few poses were found to align them."""
    try:
        return trajectory_errors(truth, found)
    except ArgumentError:
        return None


def _estimated(truth: Trajectory, errors: TrajectoryErrors) -> Trajectory:
    times = _times(truth)
    return Trajectory(tuple(errors.aligned), tuple(times[i] for i in errors.frames))


def _write(path: Path, trajectory: Trajectory) -> Path:
    with whole_file(path) as part:
        part.write_text(write_tum(trajectory), "utf-8")
    return path


def _figures(run: tuple[str, str], truth: Trajectory, errors: TrajectoryErrors | None) -> list[Figure]:
    nothing = np.full(1, np.nan)
    count = 0 if errors is None else len(errors.frames)
    off, eps_t, eps_theta, step_m, step_deg = (
        (nothing,) * 5
        if errors is None
        else (errors.position_m, errors.eps_t_deg, errors.eps_theta_deg, errors.step_m, errors.step_deg)
    )
    values = [
        ("registered", 100 * count / len(truth), "%", None),
        ("ATE, rms", 1000 * rms(off), "mm", None),
        ("ATE, rms, of the path", 100 * rms(off) / path_length(truth), "%", None),
        ("RPE, rms", 1000 * rms(step_m), "mm", None),
        ("RPE, rms, turn", rms(step_deg), "deg", None),
        ("turn, mean", float(np.mean(eps_theta)), "deg", None),
        ("eps_t, largest", float(np.max(eps_t)), "deg", PAPER_DEG),
        ("eps_theta, largest", float(np.max(eps_theta)), "deg", PAPER_DEG),
    ]
    name = ", ".join(run)
    return [
        Figure(f"{name}: {what}", value, unit, paper, len(truth) if what == "registered" else count)
        for what, value, unit, paper in values
    ]


def _rows(
    run: tuple[str, str], truth: Trajectory, errors: TrajectoryErrors | None
) -> Iterator[dict[str, Any]]:
    """A row for every frame; without errors where it was not registered."""
    index = {} if errors is None else {frame: i for i, frame in enumerate(errors.frames)}
    for frame, time in enumerate(_times(truth)):
        row: dict[str, Any] = {"camera": run[0], "method": run[1], "frame": frame, "time_s": time}
        row |= dict.fromkeys(("x_m", "y_m", "z_m", "position_m", "eps_t_deg", "eps_theta_deg"))
        if errors is not None and frame in index:
            i = index[frame]
            row |= dict(zip(("x_m", "y_m", "z_m"), errors.aligned[i].position.tolist(), strict=True))
            row["position_m"] = float(errors.position_m[i])
            row["eps_t_deg"] = float(errors.eps_t_deg[i])
            row["eps_theta_deg"] = float(errors.eps_theta_deg[i])
        yield row
