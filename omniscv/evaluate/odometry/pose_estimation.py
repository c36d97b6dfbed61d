"""Poses of the images of any central camera by COLMAP: SIFT, exhaustive matching, incremental mapping; and
the errors of an estimated trajectory.

COLMAP (Schoenberger and Frahm, CVPR 2016) has no mirrors, but it has panoramas: the features of each image
move to the pixels of a panorama that has the same rays and is as fine. Everything runs in one thread from one
seed: with more threads, points come in another order, and poses differ in the fifth digit.

A similarity first aligns the estimated positions with the true ones (Umeyama, PAMI 1991). Then, of the frames
that were registered:

ATE          distance of the positions; its root mean square. Sturm et al., IROS 2012
RPE          the error of the step from each frame to the next, position and rotation. Ibid.
eps_t        angle at a given origin between the true position and the estimated one; the paper's
eps_theta    angle of R_gt R_est^T; the paper's
"""

import signal
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from omniscv.arguments import shown
from omniscv.cameras import Camera, create
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.geometry import Array, Pose
from omniscv.planning import densities

SEED = 0
"""Of COLMAP's random numbers."""
_FATAL_ONLY = 3  # of glog's levels: a missing model is a result, and no error
_RIM_PX = 6  # SIFT finds the rim of the image circle; features this near to it are left out


def load_pycolmap() -> Any:
    """Return pycolmap.

    Raises:
        OmniscvError: it is not installed, or too old for panoramas.
    """
    handler = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as cause:
        raise OmniscvError("odometry: expected pycolmap; install omniscv[evaluate]") from cause
    finally:  # pycolmap sets a handler that prints a stack and ends the process
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)
    if not hasattr(pycolmap.CameraModelId, "EQUIRECTANGULAR"):
        wanted = "expected pycolmap 4.1 or later"
        advice = "install omniscv[evaluate]"
        raise OmniscvError(f"odometry: {wanted}, got pycolmap {pycolmap.__version__}; {advice}")
    pycolmap.logging.minloglevel = _FATAL_ONLY
    return pycolmap


def inner_mask(camera: Camera) -> NDArray[np.uint8]:
    """Return (H, W) 255 away from the rim of the field of view, else 0."""
    valid = np.asarray(camera.valid(), np.uint8) * 255
    around = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
    return np.asarray(cv2.erode(valid, around, borderType=cv2.BORDER_CONSTANT, borderValue=255), np.uint8)


def reconstruct(images: Sequence[Path], camera: Camera) -> dict[int, Pose]:
    """Return the poses of the images that COLMAP registers in its largest model, by index; none if it fails.

    ``images`` are files in one folder, of a central ``camera``.
    """
    pycolmap = load_pycolmap()
    folder = images[0].parent
    names = [path.name for path in images]
    with TemporaryDirectory() as scratch:
        pycolmap.set_random_seed(SEED)
        database = Path(scratch) / "database.db"
        mask = write_pixels(Path(scratch) / "mask.png", inner_mask(camera))
        pycolmap.extract_features(
            database,
            folder,
            image_names=names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(camera_mask_path=mask),
            extraction_options=pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1),
        )
        _move_to_panorama(database, camera)
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = SEED
        pycolmap.match_exhaustive(
            database,
            matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1),
            verification_options=verification,
        )
        mapping = pycolmap.IncrementalPipelineOptions(
            num_threads=1,
            random_seed=SEED,
            ba_refine_focal_length=False,
            ba_refine_principal_point=False,
            ba_refine_extra_params=False,
        )
        models = pycolmap.incremental_mapping(database, folder, scratch, options=mapping)
    largest: list[Any] = []
    for model in models.values():
        registered = [image for image in model.images.values() if image.has_pose]
        if len(registered) > len(largest):
            largest = registered
    poses = {}
    for image in largest:
        matrix = image.cam_from_world().inverse().matrix()
        poses[names.index(image.name)] = Pose(matrix[:, 3], matrix[:, :3])
    return poses


def _move_to_panorama(database: Path, camera: Camera) -> None:
    """Replace the camera of a database by a panorama, and its keypoints by those of the same rays."""
    pycolmap = load_pycolmap()
    height = round(np.pi / float(np.nanmedian(densities.steps(camera.unproject().directions))))
    panorama = create("equirectangular", 2 * height, height)
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            keypoints = opened.read_keypoints(image.image_id)
            directions = camera.unproject(keypoints[:, :2].astype(np.float64)).directions
            keypoints[:, :2] = panorama.project(directions)[0]
            opened.update_keypoints(image.image_id, keypoints)
        size = {"width": panorama.width, "height": panorama.height}
        model = {"model": "EQUIRECTANGULAR", "params": list(size.values()), "camera_id": image.camera_id}
        opened.update_camera(pycolmap.Camera(**model, **size))


# -- errors -------------------------------------------------------------------------------------------

FEWEST = 3
"""Positions, not on one line, that a similarity needs."""
_ON_A_LINE = 1e-9  # relative to the spread along the line


@dataclass(frozen=True, eq=False)
class TrajectoryErrors:
    """Errors of the N frames that were registered, after alignment.

    Attributes:
        frames: (N,) their indices in the true trajectory.
        aligned: (N) their estimated poses in the true world.
        position_m: (N,) distance from the true positions.
        eps_t_deg: (N,) the paper's error of positions.
        eps_theta_deg: (N,) the paper's error of rotations.
        step_m: (M,) errors of the steps between successive frames that were both registered.
        step_deg: (M,) errors of the turns between these.
    """

    frames: Sequence[int]
    aligned: Sequence[Pose]
    position_m: Array
    eps_t_deg: Array
    eps_theta_deg: Array
    step_m: Array
    step_deg: Array


def umeyama(points: Array, targets: Array) -> tuple[float, Array, Array]:
    """Return scale, rotation (3, 3), translation (3,) that map points to their targets with least squares.

    ``points`` and ``targets`` are (N, 3). ArgumentError: fewer than three, or some of them on one line.
    """
    if len(points) < FEWEST:
        raise ArgumentError(f"positions: expected {FEWEST} or more, got {len(points)}")
    mean = points.mean(axis=0)
    target_mean = targets.mean(axis=0)
    offsets = points - mean
    target_offsets = targets - target_mean
    for rows in (offsets, target_offsets):
        spread = np.linalg.svd(rows, compute_uv=False)
        if not spread[1] > _ON_A_LINE * spread[0]:
            raise ArgumentError(f"positions: expected some off a line, got spreads {shown(spread)} m")
    rotation = Rotation.align_vectors(target_offsets, offsets)[0].as_matrix()
    scale = float((target_offsets * (offsets @ rotation.T)).sum() / (offsets**2).sum())
    return scale, rotation, target_mean - scale * rotation @ mean


def trajectory_errors(
    truth: Sequence[Pose], estimates: Mapping[int, Pose], origin: ArrayLike = (0.0, 0.0, 0.0)
) -> TrajectoryErrors:
    """Return the errors of a trajectory.

    Args:
        truth: a pose for every frame, world frame.
        estimates: poses by index of the frame, in a frame and scale of their own.
        origin: (3,) of the angles eps_t, world frame.

    Raises:
        ArgumentError: fewer than three estimates, or positions on one line.
    """
    frames = sorted(estimates)
    true = [truth[frame] for frame in frames]
    estimated = [estimates[frame] for frame in frames]
    positions = _positions(true)
    scale, R, t = umeyama(_positions(estimated), positions)
    aligned = []
    turns = []
    for pose, true_pose in zip(estimated, true, strict=True):
        moved = Pose(scale * R @ pose.position + t, R @ pose.rotation)
        aligned.append(moved)
        turns.append(true_pose.R_w_c @ moved.R_w_c.T)
    reached = _positions(aligned)
    steps = _step_errors(frames, aligned, true)
    return TrajectoryErrors(
        frames=frames,
        aligned=aligned,
        position_m=np.linalg.norm(reached - positions, axis=1),
        eps_t_deg=_angles_deg(positions - np.asarray(origin), reached - np.asarray(origin)),
        eps_theta_deg=_turn_deg(turns),
        step_m=np.linalg.norm(_positions(steps), axis=1),
        step_deg=_turn_deg([step.rotation for step in steps]),
    )


def _angles_deg(first: Array, second: Array) -> Array:
    """Return the angles (N,) between two vectors (N, 3) each, degrees."""
    # By the arc tangent, which is exact for small angles; the arc cosine is not.
    across = np.linalg.norm(np.cross(first, second), axis=1)
    ahead = (first * second).sum(axis=1)
    return np.asarray(np.degrees(np.arctan2(across, ahead)))


def _step_errors(frames: Sequence[int], poses: Sequence[Pose], true: Sequence[Pose]) -> list[Pose]:
    """Return the errors of the steps between frames that follow each other, from the true step."""
    errors = []
    for number, (before, after) in enumerate(pairwise(frames)):
        if after == before + 1:
            step = poses[number].inverse() @ poses[number + 1]
            true_step = true[number].inverse() @ true[number + 1]
            errors.append(true_step.inverse() @ step)
    return errors


def path_length(poses: Sequence[Pose]) -> float:
    """Return the length of the path through poses, metres."""
    return float(np.linalg.norm(np.diff(_positions(poses), axis=0), axis=1).sum())


def rms(values: ArrayLike) -> float:
    """Return the root mean square; NaN of nothing."""
    squares = np.square(np.asarray(values, np.float64))
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


def _positions(poses: Sequence[Pose]) -> Array:
    return np.array([pose.position for pose in poses]).reshape(-1, 3)


def _turn_deg(rotations: Sequence[Array]) -> Array:
    return np.degrees(Rotation.from_matrix(np.array(rotations).reshape(-1, 3, 3)).magnitude())
