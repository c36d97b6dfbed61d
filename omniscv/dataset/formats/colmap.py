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
        images = out / "images"
        (origin, frames) = near_origin(frames)
        pictures = {frame.key: copy_lit(frame, images / frame.camera_name) for frame in frames}
        model = _Model(rigs(frames))
        paths = [pictures[frame.key] for frame in model.images]
        names = [path.relative_to(images).as_posix() for path in paths]
        if spaced := [name for name in names if " " in name]:
            wanted = "expected names of images without spaces, for COLMAP"
            raise ArgumentError(f"{wanted}, got {spaced[0]!r}")
        masks = [
            write_mask(camera.valid(), out / "masks" / f"{name}.png")
            for name, camera in model.cameras.items()
        ]
        masks += [
            write_mask(frame.valid, out / "masks" / f"{name}.png")
            for frame, name in zip(model.images, names, strict=True)
            if "unseen" in frame.files
        ]
        points = None
        if options.points is not None:
            ids = model.image_ids
            limit = options.max_relative_error
            clouds = (_observed(frame, ids[frame.key], limit) for frame in frames)
            points = _Observations(merged(clouds, options.points), len(model.images))
        paths += [mask for mask in masks if mask is not None]
        for name, of_file in model.lines(names, points).items():
            text = "".join(f"{line}\n" for line in of_file)
            paths.append(write_text(out / "sparse" / "0" / f"{name}.txt", text))
        if origin.any():
            text = "{:.0f} {:.0f} {:.0f}\n".format(*origin)
            paths.append(write_text(out / "sparse" / "0" / "origin.txt", text))
        return paths


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
        columns = points.positions_w, points.values["lit"], image, index_in_image
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for point_id, ((x, y, z), (r, g, b), image_id, index) in enumerate(rows, start=1):
            yield f"{point_id} {x} {y} {z} {r} {g} {b} 0 {image_id} {index}"


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
    """Rigs with their frames, as COLMAP numbers them.

    Attributes:
        cameras, camera_ids: by name, in the order of their ids.
        images: the frames in the order of their ids.
        image_ids: by key.
    """

    def __init__(self, rigs: Sequence[RigFrames]) -> None:
        self.rigs = rigs
        self.cameras = {name: mounted.camera for rig in rigs for name, mounted in rig.rig.cameras.items()}
        self.camera_ids = {name: i for i, name in enumerate(self.cameras, start=1)}
        self.images = [frame for rig in rigs for moment, _ in rig.moments for frame in moment.values()]
        self.image_ids = {frame.key: i for i, frame in enumerate(self.images, start=1)}

    def lines(self, names: Sequence[str], points: _Observations | None) -> dict[str, Iterable[str]]:
        """Return the lines of all files by their names, with the names of the images and their points."""
        ids = self.camera_ids
        cameras = {str(ids[name]): without_limit(camera) for name, camera in self.cameras.items()}
        frames = list[str]()
        rigs = list[str]()
        for rig_id, rig in enumerate(self.rigs, start=1):
            mounts = {ids[name]: mounted.pose for name, mounted in rig.rig.cameras.items()}
            rigs.append(colmap.rig_line(rig_id, mounts))
            for views, pose in rig.moments:
                images = {ids[name]: self.image_ids[view.key] for name, view in views.items()}
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
            indices = points.of_image(image_id).tolist() if points else []
            pixels = points.points.values["pixel"][indices].tolist() if points else []
            yield " ".join(f"{u} {v} {1 + index}" for (u, v), index in zip(pixels, indices, strict=True))
