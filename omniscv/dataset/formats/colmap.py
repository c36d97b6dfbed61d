"""COLMAP's text model: ``sparse/0/*.txt``, ``images/CAMERA/KEY.png``, and ``masks/CAMERA.png``.

Files are as COLMAP 4 reads them; before 3.12 it has no rigs and does not open their two files. Cameras with a
constant pose relative to each other are a rig (:mod:`omniscv.dataset.sequences`). Poses are from the world to
the camera, in metres, in our world frame: Z up; of the real world relative to ``sparse/0/origin.txt``, since
trainers read float32. Masks, black outside the field of view, are COLMAP's ``ImageReader.camera_mask_path``;
images with pixels that no recorded view shows have their own, ``masks/CAMERA/KEY.png.png``: ``mask_path``.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number
from omniscv.calibration import colmap
from omniscv.cameras import Camera, Equirectangular
from omniscv.dataset.exporting import Format, PointOptions, register
from omniscv.dataset.pictures import copy_lit, without_limit, write_mask
from omniscv.dataset.sequences import RigFrames, near_origin, rigs
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.planning.densities import unproject
from omniscv.records import checked, record
from omniscv.storage.local import write_text
from omniscv.truth.point_cloud import Points, merged, points_of

_FORWARD = 0.01
"""Least cosine off the axis of points: only in equirectangular images COLMAP projects points behind it."""


@record
class ColmapOptions(PointOptions):
    """Options of the format."""

    points: float | None = checked(
        number,
        above=0,
        default=None,
        help="metres: write points from depth, in each cube of that edge the nearest; default: no points",
    )


@register
class Colmap(Format):
    """See the module."""

    name = "colmap"
    needs = ("lit",)
    options = ColmapOptions

    def refuses(self, camera: Camera) -> str | None:
        return colmap.refuses(without_limit(camera))

    def write(self, frames: Sequence[Frame], out: Path, options: ColmapOptions) -> list[Path]:
        """Write pictures, masks and the model of ``frames`` into ``out``, with points if ``options`` ask.

        ArgumentError: the name of an image has a space.
        """
        images = out / "images"
        origin, frames = near_origin(frames)
        pictures = {}
        for frame in frames:
            pictures[frame.key] = copy_lit(frame, images / frame.camera_name)
        model = _Model(rigs(frames))
        paths = []
        names = []
        for frame in model.images:
            path = pictures[frame.key]
            name = path.relative_to(images).as_posix()
            if " " in name:
                wanted = "expected names of images without spaces, for COLMAP"
                raise ArgumentError(f"{wanted}, got {name!r}")
            paths.append(path)
            names.append(name)
        paths += _write_masks(model, names, out / "masks")
        points = None
        if options.points is not None:
            points = _observations(frames, model, options.points, options.max_relative_error)
        sparse = out / "sparse" / "0"
        for name, lines in model.lines(names, points).items():
            text = "".join(f"{line}\n" for line in lines)
            paths.append(write_text(sparse / f"{name}.txt", text))
        if origin.any():
            text = "{:.0f} {:.0f} {:.0f}\n".format(*origin)
            paths.append(write_text(sparse / "origin.txt", text))
        return paths


def _write_masks(model: "_Model", names: Sequence[str], folder: Path) -> list[Path]:
    """Write the masks of cameras, and of images with pixels that no recorded view shows; ``names`` are those
    of the images in the model."""
    masks = []
    for name, camera in model.cameras.items():
        masks.append(write_mask(camera.valid(), folder / f"{name}.png"))
    for frame, name in zip(model.images, names, strict=True):
        if "unseen" in frame.files:
            masks.append(write_mask(frame.valid, folder / f"{name}.png"))
    return [mask for mask in masks if mask is not None]


def _observations(
    frames: Iterable[Frame], model: "_Model", edge_m: float, max_relative: float | None
) -> "_Observations":
    """Return the points of frames, one in each cube of an edge, and which image observes each."""

    def clouds() -> Iterator[Points]:
        for frame in frames:
            yield _observed(frame, model.image_ids[frame.key], max_relative)

    return _Observations(merged(clouds(), edge_m), len(model.images))


class _Observations:
    """Points of the model, by the image that observes each.

    Args:
        points: with the values ``image``, an id, and ``pixel``.
        images: the number of images; their ids count from 1.
    """

    def __init__(self, points: Points, images: int) -> None:
        self.points = points
        image = points.values["image"]
        self._order = np.argsort(image, kind="stable")
        self._starts = np.searchsorted(image[self._order], np.arange(images + 2))

    def of_image(self, image_id: int) -> NDArray[np.intp]:
        """Return the indices of the points that an image observes."""
        return self._order[self._starts[image_id] : self._starts[image_id + 1]]

    def lines(self) -> Iterator[str]:
        """Yield the lines of ``points3D.txt``."""
        points = self.points
        image = self.points.values["image"]
        index_in_image = np.empty(len(points), np.int64)
        index_in_image[self._order] = np.arange(len(points)) - self._starts[image[self._order]]
        positions = points.positions_w.tolist()
        colors = points.values["lit"].tolist()
        image_ids = image.tolist()
        indices = index_in_image.tolist()
        for row in range(len(points)):
            x, y, z = positions[row]
            red, green, blue = colors[row]
            yield f"{row + 1} {x} {y} {z} {red} {green} {blue} 0 {image_ids[row]} {indices[row]}"


def _observed(frame: Frame, image_id: int, max_relative: float | None) -> Points:
    """The points of a frame; ``image`` is the id of the image that observes a point, ``pixel`` where."""
    cloud = points_of(frame, unproject(frame.camera, frame.camera.pixels()), max_relative)
    points_c = frame.pose.to_camera(cloud.positions_w)
    pixel, visible = frame.camera.project(points_c)
    if not isinstance(frame.camera, Equirectangular):
        visible &= points_c[:, 2] >= _FORWARD * cloud.distances
    values = {**cloud.values, "image": np.full(len(cloud), image_id), "pixel": pixel}
    return Points(cloud.positions_w, cloud.distances, values).select(visible)


class _Model:
    """Rigs with their frames, as COLMAP numbers them: from 1.

    Attributes:
        rigs: in the order of their ids.
        cameras: by name, in the order of their ids.
        camera_ids: by name.
        images: the frames in the order of their ids.
        image_ids: by key.
    """

    def __init__(self, rigs: Sequence[RigFrames]) -> None:
        self.rigs = rigs
        self.cameras: dict[str, Camera] = {}
        self.camera_ids: dict[str, int] = {}
        self.images: list[Frame] = []
        self.image_ids: dict[str, int] = {}
        for rig in rigs:
            for name, mounted in rig.rig.cameras.items():
                self.cameras[name] = mounted.camera
                self.camera_ids[name] = len(self.cameras)
            for moment, _ in rig.moments:
                for frame in moment.values():
                    self.images.append(frame)
                    self.image_ids[frame.key] = len(self.images)

    def lines(self, names: Sequence[str], points: _Observations | None) -> dict[str, Iterable[str]]:
        """Return the lines of all files by their names.

        ``names`` are those of the pictures of the images, ``points`` those of the model; None without points.
        """
        ids = self.camera_ids
        cameras = {}
        for name, camera in self.cameras.items():
            cameras[str(ids[name])] = without_limit(camera)
        frames = list[str]()
        rigs = list[str]()
        for rig_id, rig in enumerate(self.rigs, start=1):
            mounts = {}
            for name, mounted in rig.rig.cameras.items():
                mounts[ids[name]] = mounted.pose
            rigs.append(colmap.rig_line(rig_id, mounts))
            for views, pose in rig.moments:
                images = {}
                for name, view in views.items():
                    images[ids[name]] = self.image_ids[view.key]
                frames.append(colmap.frame_line(len(frames) + 1, rig_id, pose, images))
        return {
            "cameras": colmap.write_colmap(cameras).splitlines(),
            "rigs": rigs,
            "frames": frames,
            "images": self._image_lines(names, points),
            "points3D": points.lines() if points else (),
        }

    def _image_lines(self, names: Sequence[str], points: _Observations | None) -> Iterator[str]:
        """Yield the lines of ``images.txt``: two for each image, the second one with its points."""
        for image_id, (view, name) in enumerate(zip(self.images, names, strict=True), start=1):
            yield f"{image_id} {colmap.pose_words(view.pose)} {self.camera_ids[view.camera_name]} {name}"
            observed = []
            if points:
                indices = points.of_image(image_id)
                pixels = points.points.values["pixel"][indices]
                for (u, v), index in zip(pixels.tolist(), indices.tolist(), strict=True):
                    observed.append(f"{u} {v} {1 + index}")
            yield " ".join(observed)
