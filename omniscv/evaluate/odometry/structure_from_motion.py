"""Structure from motion by COLMAP, end to end: SIFT, exhaustive matching, incremental mapping.

pycolmap (BSD; the extra ``evaluate``) does it all; the camera is known and stays as it is. COLMAP's camera
frame and pixel rule are ours, so poses compare as they come. Everything runs in one thread from one seed:
with more threads, points come in another order, and poses differ in the fifth digit.

Source: J. L. Schoenberger, J.-M. Frahm, "Structure-from-motion revisited", CVPR 2016.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omniscv.calibration.colmap import camera_line
from omniscv.cameras import Camera
from omniscv.compose.files import write_picture
from omniscv.errors import OmniscvError
from omniscv.evaluate.odometry.features import inner_mask
from omniscv.geometry import Pose
from omniscv.modalities import Modality

_FATAL_ONLY = 3  # of glog's levels; that no model came about is a result
_MASK = Modality("mask", ("uint8",))


def load_pycolmap() -> Any:
    """Return pycolmap.

    Raises:
        OmniscvError: it is not installed, or too old for panoramas.
    """
    with _own_handler(signal.SIGTERM):
        try:
            import pycolmap
        except ImportError as cause:
            raise OmniscvError("odometry: expected pycolmap; install omniscv[evaluate]") from cause
    if not hasattr(pycolmap.CameraModelId, "EQUIRECTANGULAR"):
        got = f"pycolmap {pycolmap.__version__}"
        raise OmniscvError(f"odometry: expected pycolmap 4.1 or later, got {got}; install omniscv[evaluate]")
    return pycolmap


def reconstruct(images: Sequence[Path], camera: Camera, seed: int = 0) -> dict[int, Pose]:
    """Return the poses of the images that COLMAP registers in its largest model, by index; none if it fails.

    Args:
        images: files in one folder.
        camera: that took them all.
        seed: of what COLMAP draws.

    Raises:
        ArgumentError: a camera that COLMAP cannot carry.
        OmniscvError: no pycolmap, or too old a one.
    """
    pycolmap = load_pycolmap()
    _, model, _, _, *parameters = camera_line(1, camera).split()
    folder, names = images[0].parent, [path.name for path in images]
    with TemporaryDirectory() as scratch, _quiet(pycolmap):
        pycolmap.set_random_seed(seed)
        database = Path(scratch) / "database.db"
        reader = pycolmap.ImageReaderOptions(
            camera_model=model,
            camera_params=",".join(parameters),
            camera_mask_path=write_picture(Path(scratch) / "mask.png", inner_mask(camera), _MASK),
        )
        pycolmap.extract_features(
            database,
            folder,
            image_names=names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
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
    poses = [_poses(each, names) for each in models.values()]
    return max(poses, key=len, default={})


def _poses(model: Any, names: Sequence[str]) -> dict[int, Pose]:
    index = {name: i for i, name in enumerate(names)}
    matrices = {
        index[image.name]: image.cam_from_world().inverse().matrix()
        for image in model.images.values()
        if image.has_pose
    }
    return {i: Pose(matrix[:, 3], matrix[:, :3]) for i, matrix in sorted(matrices.items())}


@contextmanager
def _own_handler(number: int) -> Iterator[None]:
    """Keep the handler of a signal: pycolmap sets one that prints a stack and ends the process."""
    before = signal.getsignal(number)
    try:
        yield
    finally:
        if before is not None and threading.current_thread() is threading.main_thread():
            signal.signal(number, before)


@contextmanager
def _quiet(pycolmap: Any) -> Iterator[None]:
    """Print nothing but what ends the process."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = _FATAL_ONLY
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
