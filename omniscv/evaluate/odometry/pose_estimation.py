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
        got = f"pycolmap {pycolmap.__version__}"
        raise OmniscvError(f"odometry: expected pycolmap 4.1 or later, got {got}; install omniscv[evaluate]")
    pycolmap.logging.minloglevel = _FATAL_ONLY
    return pycolmap


def inner_mask(camera: Camera) -> NDArray[np.uint8]:
    """Return (H, W) 255 away from the rim of the field of view, else 0."""
    valid = np.asarray(camera.valid(), np.uint8) * 255
    around = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
    return np.asarray(cv2.erode(valid, around, borderType=cv2.BORDER_CONSTANT, borderValue=255), np.uint8)


def reconstruct(images: Sequence[Path], camera: Camera) -> dict[int, Pose]:
    """Return the poses of the images, files in one folder of a central camera, that COLMAP registers in its
    largest model, by index; none if it fails."""
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
    registered = [[image for image in model.images.values() if image.has_pose] for model in models.values()]
    largest = max(registered, key=len, default=[])
    matrices = {names.index(image.name): image.cam_from_world().inverse().matrix() for image in largest}
    return {index: Pose(matrix[:, 3], matrix[:, :3]) for index, matrix in matrices.items()}


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
        eps_t_deg, eps_theta_deg: (N,) the paper's two errors.
        step_m, step_deg: (M,) errors of the steps between successive frames that were both registered.
    """

    frames: Sequence[int]
    aligned: Sequence[Pose]
    position_m: Array
    eps_t_deg: Array
    eps_theta_deg: Array
    step_m: Array
    step_deg: Array


def umeyama(points: Array, targets: Array) -> tuple[float, Array, Array]:
    """Return scale, rotation, translation that map points (N, 3) to their targets with least squares;
    ArgumentError for fewer than three points, or points or targets on one line."""
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
    true = [truth[i] for i in frames]
    positions = _positions(true)
    scale, R, t = umeyama(_positions([estimates[i] for i in frames]), positions)
    aligned = [Pose(scale * R @ estimates[i].position + t, R @ estimates[i].rotation) for i in frames]
    reached = _positions(aligned)
    seen = positions - np.asarray(origin), reached - np.asarray(origin)
    # By the arc tangent, which is exact for small angles; the arc cosine is not.
    across = np.linalg.norm(np.cross(*seen), axis=1)
    ahead = (seen[0] * seen[1]).sum(axis=1)
    successive = [i for i, (a, b) in enumerate(pairwise(frames)) if b == a + 1]
    ours, theirs = ([poses[i].inverse() @ poses[i + 1] for i in successive] for poses in (aligned, true))
    steps = [true_step.inverse() @ step for step, true_step in zip(ours, theirs, strict=True)]
    return TrajectoryErrors(
        frames=frames,
        aligned=aligned,
        position_m=np.linalg.norm(reached - positions, axis=1),
        eps_t_deg=np.asarray(np.degrees(np.arctan2(across, ahead))),
        eps_theta_deg=_turn_deg([a.R_w_c @ b.R_w_c.T for a, b in zip(true, aligned, strict=True)]),
        step_m=np.linalg.norm(_positions(steps), axis=1),
        step_deg=_turn_deg([step.rotation for step in steps]),
    )


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
