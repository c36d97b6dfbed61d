"""From a plan's captures to the layers of an image, one optical centre at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, Rays
from omniscv.captures.source import Source
from omniscv.captures.view import Capture, Request, View
from omniscv.compose.depth import sample_depth
from omniscv.compose.labels import labels_of
from omniscv.compose.layers import Layers
from omniscv.errors import ArgumentError, MissingCapture
from omniscv.plan import Plan, Station
from omniscv.plan.places import Places, locate

FILTERS = ("auto", "nearest", "bilinear", "bicubic")
_INTERPOLATION = {
    "nearest": cv2.INTER_NEAREST,
    "bilinear": cv2.INTER_LINEAR,
    "bicubic": cv2.INTER_CUBIC,
}
_ROW = 1 << 14
"""Pixels a row when a station's pixels are sampled as a list: remap wants both sides below 32767."""

Progress = Callable[[int, int], None]


class Composer:
    """Composes images, and keeps rays and maps from one to the next."""

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._rays: Rays | None = None

    def compose(
        self,
        plan: Plan,
        source: Source,
        modes: Sequence[str],
        *,
        filter: str = "auto",
        progress: Progress | None = None,
    ) -> Layers:
        """The layers of a plan's image.

        Args:
            plan: the views and the pixels that they serve.
            source: where captures come from.
            modes: which layers; object_mask brings labels.
            filter: one of ``FILTERS``, for lit and depth; masks are never blended.
            progress: called with (captures done, captures in all).

        Raises:
            ArgumentError: an unknown filter.
            MissingCapture: a view that came does not see the rays it should.
            SourceError, RecordError: a capture could not be had.
        """
        if filter not in FILTERS:
            raise ArgumentError(f"filter: expected one of {', '.join(FILTERS)}; got {filter!r}")
        rays = self._rays_of(plan.camera)
        shape = rays.valid.shape
        flat: dict[str, NDArray[Any]] = {}
        centers_w = np.zeros((shape[0] * shape[1], 3)) if len(plan.stations) > 1 else None
        directions = rays.directions.reshape(-1, 3)
        captures = source.capture(
            Request(view, mode) for station in plan.stations for mode in modes for view in station.views
        )
        done, provenance = 0, {}
        for station in plan.stations:
            if centers_w is not None:
                centers_w[station.pixels] = station.center_w
            directions_w = directions[station.pixels] @ plan.pose.R_w_c.T
            kept: tuple[tuple[View, ...], Places] | None = None
            for mode in modes:
                faces = list(islice(captures, len(station.views)))
                views = tuple(capture.view for capture in faces)
                if kept is None or kept[0] != views:
                    kept = views, _located(directions_w, views, station)
                values = _sampled(mode, faces, kept[1], filter)
                if mode not in flat:
                    flat[mode] = np.zeros((shape[0] * shape[1], *values.shape[1:]), values.dtype)
                flat[mode][station.pixels] = values
                provenance = faces[0].provenance
                done += len(faces)
                if progress:
                    progress(done, len(plan) * len(modes))
        images = {mode: values.reshape(*shape, *values.shape[1:]) for mode, values in flat.items()}
        return self._layers(plan, source, rays, images, centers_w, provenance)

    def _rays_of(self, camera: Camera) -> Rays:
        if self._rays is None or self._camera != camera:
            self._camera, self._rays = camera, camera.unproject()
        return self._rays

    @staticmethod
    def _layers(
        plan: Plan,
        source: Source,
        rays: Rays,
        images: dict[str, NDArray[Any]],
        centers_w: NDArray[np.float64] | None,
        provenance: dict[str, Any],
    ) -> Layers:
        labels, objects = None, None
        unknown: dict[tuple[int, int, int], int] = {}
        if (mask := images.get("object_mask")) is not None:
            objects = source.objects()
            labels, unknown = labels_of(mask, objects)
            labels[~rays.valid] = 0
        normals = images.get("normal")
        if normals is not None:
            normals = (normals @ plan.pose.R_w_c).astype(np.float32)
        shape = rays.valid.shape
        centers = plan.stations[0].center_w if plan.stations else plan.pose.t_w_c
        return Layers(
            valid=rays.valid,
            centers_w=centers if centers_w is None else centers_w.reshape(*shape, 3),
            lit=images.get("lit"),
            object_mask=mask,
            labels=labels,
            depth=images.get("depth"),
            normals=normals,
            unknown_colors=unknown,
            objects=objects,
            provenance=provenance,
        )


def _located(directions_w: NDArray[np.float64], views: Sequence[View], station: Station) -> Places:
    places = locate(directions_w, views)
    if (unseen := int(np.count_nonzero(places.view < 0))) > 0:
        raise MissingCapture(
            f"expected {len(views)} views at {station.center_w.round(4).tolist()} m to see all "
            f"{len(places.view)} rays, but {unseen} are seen by none; capture with strategy 'cube'"
        )
    return places


def _sampled(mode: str, faces: Sequence[Capture], places: Places, filter: str) -> NDArray[Any]:
    """(N, ...) values at places."""
    rows, columns = faces[0].pixels.shape[:2]
    atlas = np.concatenate([face.pixels for face in faces])
    if mode == "depth":
        focal = np.array([face.view.focal_px for face in faces])
        return sample_depth(atlas, rows, *places, columns / 2, rows / 2, focal, nearest=filter == "nearest")
    interpolation = cv2.INTER_NEAREST if mode == "object_mask" else _INTERPOLATION[_filter_of(filter)]
    values = _remap(atlas, places, rows, interpolation)
    if mode == "normal":
        length = np.linalg.norm(values, axis=-1, keepdims=True)
        values = np.divide(values, length, out=np.zeros_like(values), where=length > 0.5)
    return values


def _filter_of(filter: str) -> str:
    return "bilinear" if filter == "auto" else filter


def _remap(atlas: NDArray[Any], places: Places, rows: int, interpolation: int) -> NDArray[Any]:
    """cv2.remap of a list of places, folded into rows."""
    count = len(places.x)
    height = -(-count // _ROW)
    x, y = np.zeros(height * _ROW, np.float32), np.zeros(height * _ROW, np.float32)
    if interpolation == cv2.INTER_NEAREST:
        # The pixel that the place lies in; remap's own rounding ties to even.
        x[:count] = np.clip(np.floor(places.x), 0, atlas.shape[1] - 1)
        y[:count] = np.clip(np.floor(places.y), 0, rows - 1)
    else:
        x[:count] = places.x - np.float32(0.5)
        y[:count] = places.y - np.float32(0.5)
    y[:count] += places.view * np.float32(rows)
    out = cv2.remap(
        atlas,
        x.reshape(height, _ROW),
        y.reshape(height, _ROW),
        interpolation,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(out.reshape(height * _ROW, *atlas.shape[2:])[:count])
