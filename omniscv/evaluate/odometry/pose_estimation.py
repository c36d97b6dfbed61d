"""Poses of cameras by COLMAP: structure from motion, relative and absolute pose from bearings.

By pycolmap (BSD; the extra ``evaluate``). COLMAP has the same camera frame and pixel rule as omniscv.
Everything runs in one thread from one seed: with more threads, points come in another order, and poses differ
in the fifth digit. COLMAP takes bearings as they are, or as pixels of a panorama: from any central camera.

Source: J. L. Schoenberger, J.-M. Frahm, "Structure-from-motion revisited", CVPR 2016.
"""

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.calibration.colmap import camera_line
from omniscv.cameras import Camera, create
from omniscv.compose.files import write_picture
from omniscv.errors import OmniscvError
from omniscv.geometry import Array, Pose
from omniscv.modalities import Modality

_FATAL_ONLY = 3  # of glog's levels: a missing model is a result, and no error
_MASK = Modality("mask", ("uint8",))
_RIM_PX = 6  # SIFT finds the rim of the image circle; features this near to it are left out
_PANORAMA = create("equirectangular", 16384, 8192)

Motion = tuple[Pose, NDArray[np.bool_]]
"""A pose, and the (N,) pairs that agree with it."""


def load_pycolmap() -> Any:
    """Return pycolmap.

    Raises:
        OmniscvError: it is not installed, or too old for panoramas.
    """
    with _kept_handler(signal.SIGTERM):
        try:
            import pycolmap
        except ImportError as cause:
            raise OmniscvError("odometry: expected pycolmap; install omniscv[evaluate]") from cause
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


def reconstruct(images: Sequence[Path], camera: Camera, seed: int = 0) -> dict[int, Pose]:
    """Return the poses of the images that COLMAP registers in its largest model, by index; none if it fails.

    SIFT, exhaustive matching, incremental mapping.

    Args:
        images: files in one folder.
        camera: of all images; it is not refined.
        seed: of COLMAP's random numbers.

    Raises:
        ArgumentError: a camera that COLMAP does not have.
        OmniscvError: no pycolmap, or too old a one.
    """
    pycolmap = load_pycolmap()
    _, model, _, _, *parameters = camera_line(1, camera).split()
    folder, names = images[0].parent, [path.name for path in images]
    with TemporaryDirectory() as scratch:
        pycolmap.set_random_seed(seed)
        database = Path(scratch) / "database.db"
        pycolmap.extract_features(
            database,
            folder,
            image_names=names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(
                camera_model=model,
                camera_params=",".join(parameters),
                camera_mask_path=write_picture(Path(scratch) / "mask.png", inner_mask(camera), _MASK),
            ),
            extraction_options=pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1),
        )
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        pycolmap.match_exhaustive(
            database,
            matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1),
            verification_options=verification,
        )
        mapping = pycolmap.IncrementalPipelineOptions(
            num_threads=1,
            random_seed=seed,
            ba_refine_focal_length=False,
            ba_refine_principal_point=False,
            ba_refine_extra_params=False,
        )
        models = pycolmap.incremental_mapping(database, folder, scratch, options=mapping)
    registered = [[image for image in model.images.values() if image.has_pose] for model in models.values()]
    largest = max(registered, key=len, default=[])
    return {names.index(image.name): _pose(image.cam_from_world()) for image in largest}


def relative_pose(first: Array, second: Array, limit_rad: float) -> Motion | None:
    """Return the pose of a second camera in the first, at any distance, and the (N,) pairs that agree.

    RANSAC with five-point essential matrices, then a refinement; None where it fails.

    Args:
        first, second: (N, 3) unit bearings; some pairs may be wrong.
        limit_rad: tolerance of bearings.
    """
    pycolmap = load_pycolmap()
    options = pycolmap.RANSACOptions(max_error=limit_rad, random_seed=0)
    found = pycolmap.estimate_relative_pose(first, second, options)
    if found is None:
        return None
    agree = found["inlier_mask"]
    refined = pycolmap.refine_relative_pose(found["cam2_from_cam1"], first, second, agree)
    return _pose((refined or found)["cam2_from_cam1"]), agree


def absolute_pose(points_w: Array, bearings: Array, limit_rad: float) -> Motion | None:
    """Return the pose from which points are seen along bearings, and the (N,) pairs that agree.

    RANSAC, then a refinement; None where it fails.

    Args:
        points_w: (N, 3).
        bearings: (N, 3) unit; some may be wrong.
        limit_rad: tolerance of bearings.
    """
    pycolmap = load_pycolmap()
    width, height = _PANORAMA.width, _PANORAMA.height
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=width, height=height, params=[width, height])
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error, options.ransac.random_seed = limit_rad * width / (2 * np.pi), 0
    pixels = _PANORAMA.project(bearings)[0]
    found = pycolmap.estimate_and_refine_absolute_pose(pixels, points_w, camera, options)
    return None if found is None else (_pose(found["cam_from_world"]), found["inlier_mask"])


def _pose(cam_from_world: Any) -> Pose:
    matrix = cam_from_world.inverse().matrix()
    return Pose(matrix[:, 3], matrix[:, :3])


@contextmanager
def _kept_handler(number: int) -> Iterator[None]:
    """Restore the handler of a signal: pycolmap sets one that prints a stack and ends the process."""
    before = signal.getsignal(number)
    try:
        yield
    finally:
        if before is not None and threading.current_thread() is threading.main_thread():
            signal.signal(number, before)
