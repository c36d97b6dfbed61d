"""Frames as a recording of the Rerun viewer: trajectory, cameras, points and images on one timeline.

Rerun has no panoramic or fisheye camera: such images are shown flat beside the points that they see.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.cameras import Camera, Pinhole
from omniscv.dataset import Frame
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.storage.local import whole_file
from omniscv.truth.point_cloud import points_of

_MOST_POINTS = 20_000
"""Of a frame: enough to show a room, few enough to turn it smoothly."""
_AXIS_M = 0.25  # length of the axes that are drawn of a camera


def check(out: Path) -> Any:
    """Return the package of Rerun, for a file whose name ends in ``.rrd``."""
    if out.suffix != ".rrd":
        raise ArgumentError(f"rerun: expected a file NAME.rrd, got {out.name!r}")
    try:
        import rerun
    except ImportError as cause:
        advice = "pip install 'omniscv[rerun]'"
        raise ArgumentError(f"rerun: expected the extra 'rerun', got: {cause}; {advice}") from cause
    return rerun


def write(frames: Sequence[Frame], out: Path) -> Path:
    """Write a file that ``rerun FILE`` shows.

    The timeline ``frame`` counts the frames of each camera; ``time`` has their seconds where they are known.
    In the space ``world`` (metres, z up) lie each camera's trajectory, its axes, and the points that it sees;
    ``images/CAMERA`` has colour, depth in metres and labels with the names of objects.

    Args:
        frames: of a dataset or a folder of images.
        out: the file, whose name ends in ``.rrd``.

    Raises:
        ArgumentError: as :func:`check`.
    """
    rerun = check(out)
    # Equal for the same frames, so that a viewer replaces a file that is written again.
    identity = f"{len(frames)} frames from {frames[0].key}" if frames else "no frames"
    stream = rerun.RecordingStream("omniscv", recording_id=identity)
    with whole_file(out) as part:
        stream.save(part)
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, group in by_camera(frames).items():
            _log_camera(rerun, stream, name, group)
        stream.flush()
        stream.disconnect()
    return out


def _log_camera(rerun: Any, stream: Any, name: str, frames: Sequence[Frame]) -> None:
    """Log what :func:`write` says of the camera ``name``, from all its ``frames``."""
    path = np.array([frame.pose.position for frame in frames])
    if len(path) > 1:
        stream.log(f"world/{name}/trajectory", rerun.LineStrips3D([path]), static=True)
    if frames[0].instances:
        names = [(0, "nothing")]
        for instance, label in frames[0].instances.items():
            names.append((label, instance))
        stream.log(f"images/{name}", rerun.AnnotationContext(names), static=True)
    camera = frames[0].camera
    if type(camera) is Pinhole:
        stream.log(f"world/{name}/camera", _pinhole(rerun, camera), static=True)
    rays = camera.unproject()
    for number, frame in enumerate(frames):
        stream.set_time("frame", sequence=number)
        if frame.time is not None:
            stream.set_time("time", duration=frame.time)
        transform = rerun.Transform3D(translation=frame.pose.position, mat3x3=frame.pose.R_w_c)
        stream.log(f"world/{name}/camera", transform, rerun.TransformAxes3D(_AXIS_M))
        _log_images(rerun, stream, name, frame)
        if "depth" in frame.files:
            cloud = points_of(frame, rays)
            step = 1 + len(cloud) // _MOST_POINTS
            thinned = cloud.select(np.arange(0, len(cloud), step))
            points = rerun.Points3D(thinned.positions_w, colors=thinned.values.get("lit"))
            stream.log(f"world/{name}/points", points)


def _pinhole(rerun: Any, camera: Camera) -> Any:
    """A camera in Rerun's convention RDF, which is ours: x right, y down, z forward."""
    step = 1e-3  # well inside any field of view
    middle, *ends = camera.project(np.array([(0, 0, 1), (step, 0, 1), (0, step, 1)]))[0]
    focal = (ends[0][0] - middle[0]) / step, (ends[1][1] - middle[1]) / step
    size = (camera.width, camera.height)
    xyz = rerun.ViewCoordinates.RDF
    return rerun.Pinhole(focal_length=focal, principal_point=middle, resolution=size, camera_xyz=xyz)


def _log_images(rerun: Any, stream: Any, name: str, frame: Frame) -> None:
    """Log the colours, depth and labels that a frame of the camera ``name`` has."""
    layers = frame.layers("lit", "depth", "labels")
    if "lit" in layers:
        lit = layers["lit"]
        stream.log(f"images/{name}/lit", rerun.Image(lit if lit.dtype == np.uint8 else lit.clip(0, 1)))
    if "depth" in layers:
        depth = np.where(np.isfinite(layers["depth"]), layers["depth"], 0)  # Rerun: 0 is unknown
        stream.log(f"images/{name}/depth", rerun.DepthImage(depth, meter=1.0))
    if "labels" in layers:
        stream.log(f"images/{name}/labels", rerun.SegmentationImage(layers["labels"]))
