"""Poses of the images of any central camera by COLMAP: SIFT, exhaustive matching, incremental mapping.

By pycolmap (BSD; the extra ``evaluate``). COLMAP has no mirrors, but it has panoramas: the features of each
image move to the pixels of a panorama that has the same rays and is as fine. Everything runs in one thread
from one seed: with more threads, points come in another order, and poses differ in the fifth digit.

Source: J. L. Schoenberger, J.-M. Frahm, "Structure-from-motion revisited", CVPR 2016.
"""

import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, create
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose
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
    """Return the poses of the images that COLMAP registers in its largest model, by index; none if it fails.

    Args:
        images: files in one folder.
        camera: of all images, central; it is not refined.

    Raises:
        OmniscvError: no pycolmap, or too old a one.
    """
    pycolmap = load_pycolmap()
    folder, names = images[0].parent, [path.name for path in images]
    with TemporaryDirectory() as scratch:
        pycolmap.set_random_seed(SEED)
        database = Path(scratch) / "database.db"
        pycolmap.extract_features(
            database,
            folder,
            image_names=names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(
                camera_mask_path=write_pixels(Path(scratch) / "mask.png", inner_mask(camera)),
            ),
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
