"""COLMAP's text model: ``sparse/0/*.txt``, ``images/CAMERA/KEY.png``, and ``masks/CAMERA.png``.

``cameras.txt``, ``rigs.txt``, ``frames.txt``, ``images.txt`` and ``points3D.txt`` are as COLMAP 4 reads them;
COLMAP before 3.12 knows no rigs and does not open their two files. Cameras that keep their places to each
other are a rig; see :mod:`omniscv.dataset.sequences`. Poses are from the world to the camera, in metres, of
our
world: Z up. Ids count from 1 in the order of the names. A mask, black outside the field of view, is written
for cameras that have such pixels; it is COLMAP's ``ImageReader.camera_mask_path``.

Options: ``points``, metres, writes points from depth: one in each cube of that edge, the one seen from
nearest, observed where it was seen; without it ``points3D.txt`` is empty. ``equirectangular: cubemap`` writes
panoramas as six ``PINHOLE`` views of a rig, for COLMAP before 4.1; the default is ``whole``.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniscv import truth
from omniscv.arguments import Reader, fields, number, one_of
from omniscv.calibration import colmap
from omniscv.cameras import Camera, Equirectangular
from omniscv.dataset.pictures import copy_lit, faces, without_limit, write_mask
from omniscv.dataset.sequences import RigFrames, rigs
from omniscv.frame import Frame
from omniscv.planning.densities import unproject
from omniscv.storage.local import whole_file
from omniscv.truth import Points
from omniscv.truth.point_cloud import points_of

name = "colmap"
needs = ("lit",)

_OPTIONS: dict[str, Reader] = {
    "points": partial(number, above=0),
    "equirectangular": partial(one_of, words=("whole", "cubemap")),
}
_FORWARD = 0.01
"""Least cosine off the axis of points: only in equirectangular images COLMAP projects what is behind."""


def refuses(camera: Camera) -> str | None:
    """Return why COLMAP cannot carry a camera; None where it can."""
    return colmap.refuses(without_limit(camera))


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields("", options, _OPTIONS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the model and its images.

    Raises:
        ArgumentError: a camera that COLMAP cannot carry, a frame without colours, or without depth where
            points are wanted, or a wrong option.
    """
    given = fields("", options, _OPTIONS)
    views = _views(frames, out / "images", given.get("equirectangular") == "cubemap")
    found = rigs([view for mine in views.values() for view in mine])
    cameras = {each: mounted.camera for one in found for each, mounted in one.rig.cameras.items()}
    camera_ids = {camera_name: i for i, camera_name in enumerate(cameras, start=1)}
    ordered = [frame for one in found for moment, _ in one.moments for frame in moment.values()]
    image_ids = {frame.key: i for i, frame in enumerate(ordered, start=1)}
    model = colmap.write_colmap({str(i): without_limit(cameras[each]) for each, i in camera_ids.items()})

    written = [frame.files["lit"] for frame in ordered]
    names = [path.relative_to(out / "images").as_posix() for path in written]
    masks = (write_mask(camera, out / "masks" / f"{each}.png") for each, camera in cameras.items())
    written += [mask for mask in masks if mask is not None]
    points = None
    if "points" in given:
        sources = [(frame, [(image_ids[view.key], view) for view in views[frame.key]]) for frame in frames]
        points = _points(sources, given["points"])
    texts = {
        "cameras": model,
        "rigs": _lines(_rig_lines(found, camera_ids)),
        "frames": _lines(_frame_lines(found, camera_ids, image_ids)),
        "images": _lines(_image_lines(ordered, names, camera_ids, points)),
        "points3D": _lines(_point_lines(points)),
    }
    folder = out / "sparse" / "0"
    folder.mkdir(parents=True, exist_ok=True)
    for each, text in texts.items():
        with whole_file(path := folder / f"{each}.txt") as part:
            part.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _views(frames: Sequence[Frame], folder: Path, cubemap: bool) -> dict[str, list[Frame]]:
    """What COLMAP gets of each frame, by its key: the frame or its cube's faces; pictures in a folder."""
    views = {}
    for frame in frames:
        if cubemap and isinstance(frame.camera, Equirectangular):
            views[frame.key] = list(faces(frame, folder))
        else:
            copied = copy_lit(frame, folder / frame.camera_name)
            views[frame.key] = [replace(frame, files={"lit": copied})]
    return views


def _lines(lines: Iterable[str]) -> str:
    return "".join(f"{line}\n" for line in lines)


def _rig_lines(found: Sequence[RigFrames], camera_ids: Mapping[str, int]) -> Iterator[str]:
    for rig_id, one in enumerate(found, start=1):
        yield colmap.rig_line(rig_id, {camera_ids[each]: m.pose for each, m in one.rig.cameras.items()})


def _frame_lines(
    found: Sequence[RigFrames], camera_ids: Mapping[str, int], image_ids: Mapping[str, int]
) -> Iterator[str]:
    frame_id = 0
    for rig_id, one in enumerate(found, start=1):
        for moment, pose in one.moments:
            frame_id += 1
            images = {camera_ids[each]: image_ids[frame.key] for each, frame in moment.items()}
            yield colmap.frame_line(frame_id, rig_id, pose, images)


def _image_lines(
    ordered: Sequence[Frame], names: Sequence[str], camera_ids: Mapping[str, int], points: Points | None
) -> Iterator[str]:
    for image_id, (frame, image_name) in enumerate(zip(ordered, names, strict=True), start=1):
        pose = colmap.pose_words(frame.pose)
        yield f"{image_id} {pose} {camera_ids[frame.camera_name]} {image_name}"
        mine = () if points is None else np.flatnonzero(points.values["image"] == image_id)
        seen = () if points is None else points.values["pixel"][mine].tolist()
        yield " ".join(f"{u} {v} {1 + index}" for (u, v), index in zip(seen, mine, strict=True))


def _points(sources: Sequence[tuple[Frame, list[tuple[int, Frame]]]], voxel_m: float) -> Points:
    """The points of frames, with ``image``, the id of the view that sees each, and ``pixel``, where.

    Args:
        sources: frames, and the views of each with their ids.
        voxel_m: edge of the cubes.
    """

    def clouds() -> Iterator[Points]:
        for frame, views in sources:
            cloud = points_of(frame, unproject(frame.camera, frame.camera.pixels()))
            image, pixel = np.zeros(len(cloud), np.int64), np.zeros((len(cloud), 2))
            for image_id, view in views:
                points_c = view.pose.to_camera(cloud.positions_w)
                pixels, seen = view.camera.project(points_c)
                if not isinstance(view.camera, Equirectangular):
                    seen &= points_c[:, 2] >= _FORWARD * cloud.distances
                image[seen], pixel[seen] = image_id, pixels[seen]
            observed = {**cloud.values, "image": image, "pixel": pixel}
            yield Points(cloud.positions_w, cloud.distances, observed).select(image > 0)

    return truth.merged(clouds(), voxel_m)


def _point_lines(points: Points | None) -> Iterator[str]:
    if points is None:
        return
    places = np.zeros(len(points), np.int64)  # of each point in its image's list
    for image_id in np.unique(points.values["image"]):
        mine = points.values["image"] == image_id
        places[mine] = np.arange(np.count_nonzero(mine))
    rows = zip(
        points.positions_w.tolist(), points.values["lit"].tolist(), points.values["image"].tolist(),
        places.tolist(), strict=True,
    )  # fmt: skip
    for point_id, ((x, y, z), (r, g, b), image_id, place) in enumerate(rows, start=1):
        yield f"{point_id} {x} {y} {z} {r} {g} {b} 0 {image_id} {place}"
