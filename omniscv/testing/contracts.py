"""The contracts of sources and camera models, as checks that know none; AssertionError where one fails."""

import copy
import itertools
import json
import pickle
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from omniscv import cameras, modalities
from omniscv.cameras import Camera
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, Source, View

ASIDE = (0.1, 0.05, 0.0)  # metres, of a second position: sources may take the views of one together


def face_requests(source: Source, position: Sequence[float], edge: int) -> list[Request]:
    """Return requests in all modes of the faces of cubes at two positions, as the source covers them.

    Those of a recording are of its first views.

    Args:
        source: open.
        position: (3,) metres, world frame, the first of both.
        edge: of pictures, px, if the source can choose.
    """
    own = source.capabilities
    fov_deg = own.fov_deg or 90.0
    width, height = own.image_size or (edge, edge)
    views: list[View] = []
    recorded = source.recorded_views()
    if recorded is not None:
        views += recorded[:16]
    else:
        for center in (np.asarray(position, float), np.add(position, ASIDE)):
            for _, R_w_c in cube_rotations():
                views += source.cover(View(Pose(center, R_w_c), fov_deg, width, height))
    requests = []
    for mode in sorted(source.capabilities.modes):
        requests += [Request(view, mode) for view in views]
    return requests


def check_source(source: Source, position: Sequence[float] = (0.0, 0.0, 1.5), edge: int = 16) -> None:
    """Check the contract of an open source, as for one of a package; it captures some hundred small pictures.

    Order, laziness, pixels of each modality, objects.

    Args:
        source: open.
        position: (3,) metres, world frame: in free space.
        edge: of pictures, px, if the source can choose.

    Raises:
        AssertionError: a promise that it breaks.
    """
    requests = face_requests(source, position, edge)
    check_order(source, requests)
    check_pixels(source, requests)
    check_objects(source, requests)
    if source.capabilities.traces:
        check_rays(source, requests)
    if source.capabilities.shades and "lit" in source.capabilities.modes:
        check_shades(source, requests)


def check_order(source: Source, requests: Sequence[Request]) -> None:
    """Captures of a ``source`` come in the order of ``requests``, which are read as captures are taken; calls
    may interleave."""
    mixed = [*requests[::5], *requests[3::7], *requests[:3]]
    captures = list(source.capture(mixed))
    assert [capture.request for capture in captures] == mixed
    assert [capture.mode for capture in captures] == [request.mode for request in mixed]
    read: list[Request] = []

    def endless_requests() -> Iterator[Request]:
        for request in itertools.cycle(requests):
            read.append(request)
            yield request

    endless = source.capture(endless_requests())
    assert read == [], "requests are read before a capture is taken"
    assert next(endless).request == requests[0]
    assert len(read) <= 400, "more requests are read than a batch"
    getattr(endless, "close", lambda: None)()
    first = source.capture(requests[:4])
    second = source.capture(requests[4:8])
    interleaved = []
    for capture, other in zip(first, second, strict=True):
        interleaved.append((capture.request, other.request))
    assert interleaved == list(zip(requests[:4], requests[4:8], strict=True))


def check_pixels(source: Source, requests: Sequence[Request]) -> None:
    """Pixels that a ``source`` gives for ``requests`` have the dtype, shape and values of their modality.

    Their provenance is plain JSON.
    """
    table = source.objects()
    for capture in source.capture(requests):
        modality = modalities.get(capture.mode)
        pixels = capture.pixels
        view = capture.view
        ids = bool(table.ids) and capture.mode == "object_mask"
        assert modality.fits(pixels) or (ids and pixels.dtype == np.uint16 and pixels.ndim == 2), capture.mode
        assert pixels.shape[:2] == (view.height, view.width)
        assert not pixels.flags.writeable, "pixels can be written into"
        if capture.mode == "depth":
            assert (pixels > 0).all(), "depth is above 0, inf where there is no surface"
        if capture.mode == "normals":
            lengths = np.linalg.norm(pixels, axis=-1)
            assert np.allclose(lengths[lengths > 0], 1, atol=1e-5), "normals have length 1"
        if ids:
            assert set(np.unique(pixels).tolist()) <= {0, *table.ids.values()}
        json.dumps(dict(capture.provenance))


def check_objects(source: Source, requests: Sequence[Request]) -> None:
    """Objects of a ``source`` have the same names and colours after captures of the first ``requests``.

    Their labels are in the order of names.
    """
    before = source.objects()
    list(source.capture(requests[:2]))
    assert source.objects() == before
    assert list(map(before.label, before.names())) == list(range(1, 1 + len(before.names())))


def check_rays(source: Source, requests: Sequence[Request]) -> None:
    """Rays of a ``source`` meet what its pictures show at the middles of their pixels.

    A pixel in a hundred may differ, at edges. Pictures are those of some ``requests`` that are no colours.
    """
    masks = source.objects().mask_values()
    for capture in source.capture([request for request in requests if request.mode != "lit"][::7]):
        view = capture.view
        pixels = capture.pixels
        hits = source.trace(view.pose.position, view.directions_w())
        assert np.array_equal(np.isinf(hits.distance), hits.label == 0)
        rays = {
            "depth": (hits.distance / view.ray_lengths()).astype(np.float32),
            "object_mask": masks[hits.label],
            "normals": hits.normal.astype(np.float32),
        }[capture.mode]
        with np.errstate(invalid="ignore"):
            off = ~((rays == pixels) | (np.abs(rays.astype(float) - pixels) < 1e-3))
        assert off.mean() <= 0.01, f"rays meet other {capture.mode} than pictures show"


def check_shades(source: Source, requests: Sequence[Request]) -> None:
    """Rays of a ``source`` have the colours that its pictures show at the middles of their pixels.

    A pixel in fifty may differ by more than two codes, at edges. Pictures are those of some ``requests`` of
    colours.
    """
    for capture in source.capture([request for request in requests if request.mode == "lit"][::5]):
        view = capture.view
        rays = view.directions_w().reshape(-1, 3)
        shades = source.shade(view.pose.position, rays)
        assert shades.dtype == np.float32
        assert shades.shape == rays.shape
        assert np.isfinite(shades).all(), "rays have colours that are no numbers"
        own = source.shade(np.broadcast_to(view.pose.position, rays.shape), rays)
        assert np.array_equal(own, shades), "rays of one origin have other colours than rays with own ones"
        shown = capture.pixels.astype(np.float64).reshape(-1, 3)
        if capture.pixels.dtype == np.uint8:
            shown /= 255
        off = np.abs(shades - shown).max(axis=1) > 2 / 255
        assert off.mean() <= 0.02, "rays have other colours than pictures show"


Floats = NDArray[np.float64]

PIXEL_TOLERANCE = 1e-6  # px; the promise
NUDGE_PX = 1e-7  # well within the promise
NUDGE_PARTS = np.array([1, 1e-2, 1e-4, 1e-7])  # smaller ones for images smaller than a nudge
ANGLE_TOLERANCE = 1e-12  # rad, beside the turn of a ray by a nudge of its pixel
CENTRAL_METRES = 10.0 ** np.array([-9, 0, 9])
_LAST_PLACES = 1e-15  # relative: four units in the last place of float64
NONCENTRAL_METRES = 10.0 ** np.array([1, 3, 9])  # beyond the mirrors of the examples
AZIMUTHS = np.linspace(-np.pi, np.pi, 25)


# -- pixels -------------------------------------------------------------------------------------


def all_pixels(camera: Camera) -> Floats:
    """Return (N, 2) the centres and the corners of all pixels: the image's middle, edges, seam and poles."""
    corners = np.meshgrid(np.arange(camera.width + 1.0), np.arange(camera.height + 1.0))
    return np.concatenate([camera.pixels().reshape(-1, 2), np.stack(corners, axis=-1).reshape(-1, 2)])


def last_pixels(camera: Camera) -> Any:
    """Return (N, 2) the outermost valid pixels in all directions, to the last bit, by bisection."""
    pixels = all_pixels(camera)
    pixels = pixels[camera.valid(pixels)]
    if not len(pixels):
        return pixels
    anchor = pixels[np.argmin(np.linalg.norm(pixels - camera.center, axis=1))]
    toward = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=-1)
    low = np.zeros(len(toward))
    high = np.full(len(toward), 2.0 * (camera.width + camera.height))
    for _ in range(80):
        middle = (low + high) / 2
        inside = camera.valid(anchor + middle[:, None] * toward)
        low = np.where(inside, middle, low)
        high = np.where(inside, high, middle)
    last = anchor + low[:, None] * toward
    # Next to a cone's tip (a border, too) the points on neighbouring rays are one point in float64.
    return last[np.linalg.norm(last - camera.center, axis=1) > 1e-9]


# -- checks -------------------------------------------------------------------------------------


def round_trip_error(camera: Camera) -> float:
    """Return the largest |project(unproject(p)) - p|, px, at any distance; inf if a pixel is lost."""
    pixels = np.concatenate([all_pixels(camera), last_pixels(camera)])
    rays = camera.unproject(pixels)
    pixels = pixels[rays.valid]
    origins = rays.origins[rays.valid]
    directions = rays.directions[rays.valid]
    worst = 0.0
    for metres in CENTRAL_METRES if camera.central else NONCENTRAL_METRES:
        again, seen = camera.project(origins + metres * directions)
        if not seen.all():
            return np.inf
        error = np.abs(again - pixels).max(axis=1, initial=0.0)
        other = error > PIXEL_TOLERANCE
        other[other] = ~see_one_ray(camera, pixels[other], again[other])
        worst = max(worst, error[other].max(initial=0.0), error[error <= PIXEL_TOLERANCE].max(initial=0.0))
    return worst


def see_one_ray(camera: Camera, pixels: Floats, others: Floats) -> Any:
    """Return (N,) whether ``pixels`` and ``others`` of a ``camera``, (N, 2), see one ray each.

    They do at a seam or pole, to within the tolerance.
    """
    rays = camera.unproject(pixels)
    same = camera.unproject(others)
    around = PIXEL_TOLERANCE * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])[:, None]
    nearby = camera.unproject(pixels + around)
    alike = same.valid
    for part in ("origins", "directions"):
        own = getattr(rays, part)
        allowed = np.nanmax(np.linalg.norm(getattr(nearby, part) - own, axis=-1), axis=0)
        alike = alike & (np.linalg.norm(getattr(same, part) - own, axis=-1) <= allowed + 1e-15)
    return alike


def check_round_trip(camera: Camera) -> None:
    """A pixel's ray, at any distance, is projected to the pixel."""
    assert round_trip_error(camera) <= PIXEL_TOLERANCE


def check_arrays(camera: Camera) -> None:
    """Shapes and dtypes; unit directions and finite origins where valid, NaN elsewhere."""
    for shape in ((), (0,), (7,), (3, 5)):
        pixels = np.random.default_rng(1).uniform(0, (camera.width, camera.height), (*shape, 2))
        rays = camera.unproject(pixels)
        again, seen = camera.project(np.ones((*shape, 3)))
        assert rays.origins.shape == rays.directions.shape == (*shape, 3)
        assert rays.valid.shape == seen.shape == shape
        assert again.shape == (*shape, 2)
        assert rays.valid.dtype == seen.dtype == bool
        assert rays.origins.dtype == rays.directions.dtype == again.dtype == np.float64
    rays = camera.unproject()
    assert rays.valid.shape == (camera.height, camera.width)
    np.testing.assert_array_equal(camera.valid(), rays.valid)
    assert np.isfinite(rays.origins[rays.valid]).all()
    # A handful of roundings.
    np.testing.assert_allclose(np.linalg.norm(rays.directions[rays.valid], axis=-1), 1, rtol=1e-15 * 4)
    assert np.isnan(rays.origins[~rays.valid]).all()
    assert np.isnan(rays.directions[~rays.valid]).all()
    if camera.central:
        assert not rays.origins[rays.valid].any()


def check_outside(camera: Camera) -> None:
    """Pixels outside the image and pixels that are not finite have no ray."""
    u = camera.width / 2
    v = camera.height / 2
    beside = [(-1e-9, v), (2 * u + 1e-9, v), (u, -1e-9), (u, 2 * v + 1e-9), (1e300, -1e300)]
    nowhere = [(np.nan, v), (u, np.nan), (np.inf, v), (u, -np.inf)]
    assert not camera.valid(np.array(beside + nowhere)).any()


def check_points(camera: Camera) -> None:
    """Points on the axes, at the optical centres, near and far, and points that are not finite."""
    special = [0.0, 1.0, -1.0, 0.3, 1e-9, -1e9, 1e300, np.nan, -np.inf]
    rays = camera.unproject()
    check_projection(
        camera, np.concatenate([list(itertools.product(special, repeat=3)), rays.origins[rays.valid][::7]])
    )


def length(vectors: Floats) -> Any:
    """Return (...) lengths of (..., 3) vectors as long as 1e250: squares of 1e155 leave float64."""
    return np.linalg.norm(vectors / 1e100, axis=-1) * 1e100


def check_projection(
    camera: Camera, points: Floats, tolerance: float = ANGLE_TOLERANCE, at_the_border: float = 0.0
) -> None:
    """Each point (N, 3) is invalid, or the ray of its pixel points to it.

    Args:
        camera: any.
        points: (N, 3) camera frame, metres.
        tolerance: rad, beside the turn and shift of the ray by a nudge of the pixel.
        at_the_border: the turn, rad, where a nudge leaves the image.
    """
    pixels, valid = camera.project(points)
    assert not valid[~np.isfinite(points).all(axis=1)].any()
    assert np.isnan(pixels[~valid]).all()
    rays = camera.unproject(pixels[valid])
    assert rays.valid.all()
    offset = points[valid] - rays.origins
    distance = length(offset)
    # Next to a cone's tip the rounding of the pixel moves the point, whatever the angle.
    away = distance > 1e-12 * length(rays.origins)
    offset = offset[away]
    directions = rays.directions[away]
    offset /= np.abs(offset).max(axis=1, keepdims=True)
    offset /= np.linalg.norm(offset, axis=1, keepdims=True)
    assert ((offset * directions).sum(axis=1) > 0).all()
    angle = np.linalg.norm(np.cross(offset, directions), axis=1)
    moved, turned = changes_by_a_nudge(camera, pixels[valid][away], at_the_border)
    rounding = (moved + 1e-12 * length(rays.origins[away])) / distance[away]
    assert (angle <= tolerance + turned + rounding).all()


def changes_by_a_nudge(camera: Camera, pixels: Floats, at_the_border: float) -> tuple[Any, Any]:
    """Return how far nudges of ``pixels`` (N, 2) of a ``camera`` move their rays, m (N,), and turn them, rad.

    ``at_the_border`` is the turn, rad, where a nudge leaves the image.
    """
    aside = np.multiply.outer(NUDGE_PX * NUDGE_PARTS, [[-1, 0], [1, 0], [0, -1], [0, 1]]).reshape(-1, 1, 2)
    own = camera.unproject(pixels)
    beside = camera.unproject(pixels + aside)
    turned = np.linalg.norm(beside.directions - own.directions, axis=-1)
    moved = length(beside.origins - own.origins)
    turned = np.where(np.isnan(turned), at_the_border, turned)
    return np.nan_to_num(moved).max(axis=0), turned.max(axis=0)


def check_description(camera: Camera) -> None:
    """``to_dict`` and back, by way of JSON, is the same camera to the bit."""
    described = json.loads(json.dumps(camera.to_dict()))
    again = cameras.from_dict(described)
    assert again == camera != described
    assert hash(again) == hash(camera)
    assert again.to_dict() == described
    assert type(again) is type(camera)
    np.testing.assert_array_equal(again.unproject().directions, camera.unproject().directions)


def check_narrow_numbers(camera: Camera) -> None:
    """Pixels and points in float32 or whole numbers give the float64 results of the same numbers.

    Four units in the last place are left to NumPy, which computes strided arrays by other loops.
    """
    pixels = all_pixels(camera)
    for narrow in (pixels.astype(np.float32), pixels.astype(np.int32), pixels.astype(np.uint8)):
        given = camera.unproject(narrow)
        wide = camera.unproject(narrow.astype(np.float64))
        np.testing.assert_allclose(given.directions, wide.directions, rtol=_LAST_PLACES, atol=_LAST_PLACES)
        assert given.directions.dtype == np.float64
    points = np.random.default_rng(2).normal(size=(1000, 3)).astype(np.float32) * 5
    for values in (points, (100 * points).astype(np.int16)):
        pixels, valid = camera.project(values)
        wide_pixels, wide_valid = camera.project(values.astype(float))
        np.testing.assert_allclose(pixels, wide_pixels, rtol=_LAST_PLACES)
        np.testing.assert_array_equal(valid, wide_valid)


def check_viewpoints(camera: Camera) -> None:
    """Valid pixels have an optical centre, other pixels have none."""
    views = camera.viewpoints()
    np.testing.assert_array_equal(views.index >= 0, camera.valid())
    assert views.index.max(initial=-1) < len(views.centers)
    assert np.isfinite(views.centers).all()
    if camera.central:
        np.testing.assert_array_equal(views.centers, np.zeros((1, 3)))


def check_immutable(camera: Camera) -> None:
    """No attribute can be set, deleted or written into; a copy is equal and immutable, too."""
    described = camera.to_dict()
    for same in (camera, copy.deepcopy(camera), pickle.loads(pickle.dumps(camera))):  # noqa: S301
        assert same == camera
        assert hash(same) == hash(camera)
        for key in (*described, "center", "anything"):
            with pytest.raises(AttributeError, match="cameras are immutable; create another one"):
                setattr(same, "name" if key == "model" else key, 1)
        with pytest.raises(AttributeError, match="immutable"):
            del same.width
        for key in (*described, "center"):
            value = getattr(same, key, None)
            if isinstance(value, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    value[...] = 0
    assert camera.to_dict() == described


NUMERIC_CHECKS = (check_round_trip, check_arrays, check_points, check_viewpoints, check_description)
CHECKS = (*NUMERIC_CHECKS, check_immutable, check_outside, check_narrow_numbers)


def check_camera(camera: Camera) -> None:
    """Check the contract of a camera, as for a model of a package.

    Pixels come back from their rays to 1e-6 px; shapes, dtypes, validity; the description and back; the
    optical centres; immutability.

    Raises:
        AssertionError: a promise that it breaks.
    """
    for check in CHECKS:
        check(camera)
