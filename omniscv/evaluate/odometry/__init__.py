"""The evaluation ``odometry``: COLMAP's poses of the images of a flight, scored by the true poses.

A panorama, a fisheye and a camera below a mirror fly. Non-central cameras are left out: COLMAP assumes that
all rays of an image start at one point. The paper's evaluation with OpenVSLAM.

Option ``trajectory``: a TUM, KITTI or EuRoC file of poses in place of the loop in the mock's room.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from omniscv.cameras import create
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.compose.renderer import Renderer
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.evaluate import Figure, Report, Row, Settings, chart
from omniscv.evaluate.odometry.pose_estimation import (
    SEED,
    TrajectoryErrors,
    load_pycolmap,
    path_length,
    reconstruct,
    rms,
    trajectory_errors,
)
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.geometry.trajectory_files import read_trajectory, write_tum
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source
from omniscv.sources.registry import open_source
from omniscv.storage.local import write_text

OPTIONS = frozenset({"trajectory"})

SOURCE = "scene://four-wall"
SECONDS = 28.0
"""Of the flight, as in the paper."""
PAPER_DEG = 8.0
"""Bound of both errors of the paper, over the whole flight."""

_COLORS = {"panorama": "#00798c", "fisheye": "#edae49", "mirror": "#6a4c93"}
_LEAST_DEG = 1e-3  # of the logarithmic axes
_NO_ERRORS = TrajectoryErrors((), (), *[np.zeros(0)] * 5)


def evaluate(settings: Settings) -> Report:
    """Render the flight, estimate it from the images of each camera, and score it.

    Images and trajectories stay in ``settings.out / "odometry"``, for use with other programs.

    Raises:
        ArgumentError: a trajectory cannot be read.
        OmniscvError: no pycolmap; of the source.
    """
    pycolmap = load_pycolmap()
    truth, rig = _truth_and_rig(settings)
    times = truth.seconds or tuple(map(float, range(len(truth))))
    folder = settings.out / "odometry"
    steps = len(truth) * (1 + len(rig.cameras))
    with open_source(settings.source or SOURCE) as source:
        images = render(rig, truth, source, folder, lambda done: settings.progress(done, steps))
    written = [write_text(folder / "truth.tum", write_tum(truth))]
    runs = dict[str, TrajectoryErrors]()
    figures: list[Figure] = []
    rows: list[Row] = []
    for number, (name, mounted) in enumerate(rig.cameras.items(), start=1):
        errors = _estimate(images[name], mounted, truth)
        runs[name] = errors
        figures += _figures(name, truth, errors)
        rows += _rows(name, times, errors)
        if errors.frames:
            seconds = [times[frame] for frame in errors.frames]
            aligned = Trajectory.timed(tuple(errors.aligned), seconds)
            written.append(write_text(folder / f"{name}.tum", write_tum(aligned)))
        settings.progress((1 + number) * len(truth), steps)
    cameras = {}
    for name, mounted in rig.cameras.items():
        cameras[name] = mounted.camera.to_dict()
    about = {
        "source": settings.source or SOURCE,
        "cameras": cameras,
        "poses": len(truth),
        "path_m": path_length(truth),
        "origin of eps_t": [0.0, 0.0, 0.0],
        "pycolmap": pycolmap.__version__,
        "seed": SEED,
    }
    return Report(figures, rows, about, [draw(runs, truth, times, settings.out / "odometry.png"), *written])


def _truth_and_rig(settings: Settings) -> tuple[Trajectory, Rig]:
    """Return the flight, or the trajectory of a file, and the rig that moves along it."""
    count = 20 if settings.quick else 60
    truth = flight(count)
    path = settings.options.get("trajectory")
    if path is not None:
        truth = read_trajectory(Path(path))
        if settings.quick:
            truth = truth[:: -(-len(truth) // count)]
    rig = rig_of(768, 512) if settings.quick else rig_of(1024, 640)
    return truth, rig


def _estimate(images: Sequence[Path], mounted: RigCamera, truth: Trajectory) -> TrajectoryErrors:
    """Return the errors of the rig's poses that are estimated from the images of one of its cameras."""
    T_cam_rig = mounted.pose.inverse()
    estimates = {}
    for frame, pose in reconstruct(images, mounted.camera).items():
        estimates[frame] = pose @ T_cam_rig
    try:
        return trajectory_errors(truth, estimates)
    except ArgumentError:  # too few poses to align them
        return _NO_ERRORS


def flight(count: int) -> Trajectory:
    """Return a closed loop of 6.7 m through the free middle of the mock's rooms.

    It is 1.35 to 1.65 m above the floor; the camera looks ahead, and pitches and rolls by up to 5 degrees.
    """
    poses = []
    for turn in 2 * np.pi * np.arange(count) / count:  # radians
        pose = Pose.from_angles(
            (np.cos(turn) - 0.4, 1.1 * np.sin(turn), 1.5 + 0.15 * np.sin(2 * turn)),
            yaw_deg=np.degrees(np.arctan2(1.1 * np.cos(turn), -np.sin(turn))),
            pitch_deg=5 * np.sin(3 * turn),
            roll_deg=5 * np.cos(2 * turn),
        )
        poses.append(pose)
    return Trajectory.timed(tuple(poses), (SECONDS * np.arange(count) / count).tolist())


def rig_of(width: int, edge: int) -> Rig:
    """Return a panorama ``width`` px wide and a fisheye that look ahead, and a camera below a hyperbolic
    mirror that looks up; these two are ``edge`` px wide and high."""
    panorama = create("equirectangular", width, width // 2)
    fisheye = create("fisheye-equidistant", edge, edge, fov_deg=170.0)
    mirror = RigCamera.turned(create("catadioptric-hyperbolic", edge, edge), pitch_deg=90)
    return Rig({"panorama": RigCamera(panorama), "fisheye": RigCamera(fisheye), "mirror": mirror})


def render(
    rig: Rig, trajectory: Trajectory, source: Source, folder: Path, progress: Callable[[int], None]
) -> dict[str, list[Path]]:
    """Write the images of each camera of a rig as ``CAMERA/0000.png`` and so on, and return them by camera.

    Args:
        rig: the cameras.
        trajectory: of the rig, world frame.
        source: of the scene.
        folder: in which each camera gets a folder.
        progress: called with the number of poses done.

    Raises:
        ArgumentError: the source's colours are no bytes.
    """
    # With one size of faces, the cameras share captures. It exceeds the resolution of panorama and fisheye.
    widest_px = max(mounted.camera.width for mounted in rig.cameras.values())
    options = RenderOptions(face_size=widest_px // 2)
    renderer = Renderer(source)
    written: dict[str, list[Path]] = {name: [] for name in rig.cameras}
    for number, pose in enumerate(trajectory):
        cameras = [(mounted.camera, pose @ mounted.pose) for mounted in rig.cameras.values()]
        images = renderer.render_together(cameras, ("lit",), options)
        for name, image in zip(rig.cameras, images, strict=True):
            if image.lit is None or image.lit.dtype != np.uint8:
                raise ArgumentError("source: expected colours as bytes, got others; leave out lit=float32")
            written[name].append(write_pixels(folder / name / f"{number:04d}.png", image.lit))
        progress(number + 1)
    return written


def _figures(name: str, truth: Trajectory, errors: TrajectoryErrors) -> list[Figure]:
    count = len(errors.frames)
    off = rms(errors.position_m)
    unknown = np.array([np.nan])
    eps_t, eps_theta = (errors.eps_t_deg, errors.eps_theta_deg) if count else (unknown, unknown)
    return [
        Figure(f"{name}: registered", 100 * count / len(truth), "%", n=len(truth)),
        Figure(f"{name}: ATE, rms", 1000 * off, "mm", n=count),
        Figure(f"{name}: ATE, rms, of the path", 100 * off / path_length(truth), "%", n=count),
        Figure(f"{name}: RPE, rms", 1000 * rms(errors.step_m), "mm", n=count),
        Figure(f"{name}: RPE, rms, turn", rms(errors.step_deg), "deg", n=count),
        Figure(f"{name}: turn, mean", float(eps_theta.mean()), "deg", n=count),
        Figure(f"{name}: eps_t, largest", float(eps_t.max()), "deg", PAPER_DEG, count),
        Figure(f"{name}: eps_theta, largest", float(eps_theta.max()), "deg", PAPER_DEG, count),
    ]


def _rows(name: str, times: Sequence[float], errors: TrajectoryErrors) -> Iterator[Row]:
    """Yield a row for every frame, with errors if it was registered."""
    index_of = {frame: index for index, frame in enumerate(errors.frames)}
    for frame, time in enumerate(times):
        row: dict[str, Any] = {"camera": name, "frame": frame, "time_s": time}
        row |= dict.fromkeys(("x_m", "y_m", "z_m", "position_m", "eps_t_deg", "eps_theta_deg"))
        if frame in index_of:
            index = index_of[frame]
            row["x_m"], row["y_m"], row["z_m"] = errors.aligned[index].position.tolist()
            for key in ("position_m", "eps_t_deg", "eps_theta_deg"):
                row[key] = float(getattr(errors, key)[index])
        yield row


def draw(
    runs: Mapping[str, TrajectoryErrors], truth: Sequence[Pose], times: Sequence[float], path: Path
) -> Path:
    """Draw both errors of each frame at its time, and the trajectories from above; return ``path``.

    Args:
        runs: the errors by camera.
        truth: the true poses.
        times: of the poses, seconds.
        path: of the picture.
    """
    with chart(path, 1200, 460) as drawing:
        position, orientation, above = drawing.subplots(1, 3, width_ratios=(1.15, 1.15, 1))
        above.plot(*_from_above(truth), "-", color="#d1495b", lw=4, alpha=0.5, label="truth")
        for name, errors in runs.items():
            if errors.frames:
                color = _COLORS[name]
                seconds = [times[frame] for frame in errors.frames]
                position.plot(seconds, np.maximum(errors.eps_t_deg, _LEAST_DEG), lw=1.6, color=color)
                orientation.plot(seconds, np.maximum(errors.eps_theta_deg, _LEAST_DEG), lw=1.6, color=color)
                above.plot(*_from_above(errors.aligned), lw=1.2, label=name, color=color)
        _label(position, "position error $\\varepsilon_t$ (degrees)")
        _label(orientation, "orientation error $\\varepsilon_\\theta$ (degrees)")
        above.set(xlabel="x (m)", ylabel="y (m)", title="trajectory from above", aspect="equal")
        above.legend(fontsize=9, loc="center")
        above.grid(lw=0.4, alpha=0.5)
    return path


def _from_above(poses: Sequence[Pose]) -> Array:
    """Return x and y, (2, N)."""
    return np.array([pose.position[:2] for pose in poses]).T


def _label(axes: Axes, title: str) -> None:
    axes.axhline(PAPER_DEG, color="#9aa3b2", ls=":", lw=2)
    axes.annotate(
        f"the paper's errors are below {PAPER_DEG:g} degrees", (0.02, PAPER_DEG), (0, -5),
        xycoords=("axes fraction", "data"), textcoords="offset points", va="top", size=9,
    )  # fmt: skip
    axes.set(yscale="log", xlabel="time (s)", title=title, ylim=(None, 1.4 * PAPER_DEG))
    axes.grid(lw=0.4, alpha=0.5, which="both")
