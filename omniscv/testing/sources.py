"""The contract of sources, as checks of an open one; AssertionError where one fails."""

import itertools
import json
from collections.abc import Iterator, Sequence

import numpy as np

from omniscv import modalities
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, Source, View

ASIDE = (0.1, 0.05, 0.0)  # metres, of a second position: sources may take the views of one together


def face_requests(source: Source, position: Sequence[float], edge: int) -> list[Request]:
    """Return requests in all modes of the faces of cubes at two positions, as the source covers them.

    Those of a recording are of its first views.
    """
    own = source.capabilities
    shape = own.fov_deg or 90.0, *(own.image_size or (edge, edge))
    centers = np.asarray(position, float), np.add(position, ASIDE)
    faces = [View(Pose(at, R_w_c), *shape) for at in centers for _, R_w_c in cube_rotations()]
    recorded = source.recorded_views()
    views = [view for face in faces for view in source.cover(face)] if recorded is None else recorded[:16]
    return [Request(view, mode) for mode in sorted(source.capabilities.modes) for view in views]


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


def check_order(source: Source, requests: Sequence[Request]) -> None:
    """Captures come in the order of requests, which are read as captures are taken; calls may interleave."""
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
    pairs = list(zip(source.capture(requests[:4]), source.capture(requests[4:8]), strict=True))
    assert [[one.request, other.request] for one, other in pairs] == [
        [one, other] for one, other in zip(requests[:4], requests[4:8], strict=True)
    ]


def check_pixels(source: Source, requests: Sequence[Request]) -> None:
    """Pixels have the dtype, shape and values of their modality, and what they show is described."""
    table = source.objects()
    for capture in source.capture(requests):
        row, pixels, view = modalities.get(capture.mode), capture.pixels, capture.view
        ids = bool(table.ids) and capture.mode == "object_mask"
        assert row.fits(pixels) or (ids and pixels.dtype == np.uint16 and pixels.ndim == 2), capture.mode
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
    """Objects have the same names and colours after captures, and labels in the order of names."""
    before = source.objects()
    list(source.capture(requests[:2]))
    assert source.objects() == before
    assert [before.label(name) for name in before.names()] == list(range(1, 1 + len(before.names())))


def check_rays(source: Source, requests: Sequence[Request]) -> None:
    """Rays meet what pictures show at the middles of their pixels, but for a pixel in a hundred at edges."""
    masks = source.objects().mask_values()
    for capture in source.capture([request for request in requests if request.mode != "lit"][::7]):
        view, pixels = capture.view, capture.pixels
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
