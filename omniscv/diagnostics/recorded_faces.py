"""Steps across the edges of recorded cubes, and their causes."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from omniscv.diagnostics import Finding
from omniscv.diagnostics.posed_pictures import examine_views
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Array, cube_rotations
from omniscv.pictures import png
from omniscv.sources.base import Request, Source
from omniscv.sources.developing.cube import Cube
from omniscv.sources.developing.seams import Gains, estimate_gains
from omniscv.sources.developing.slips import POOLED, pooled_vignette, proven_turns
from omniscv.sources.labels import labels_of, labels_of_ids
from omniscv.storage.local import whole_file

_STEP = 2.0  # levels across an edge that show
_BAD_STEP = 10.0
_DRAWN_PX = 64  # of each face beside the worst edge
_AT_SOURCE = "record with manual exposure, without vignette, bloom and screen-space reflections"


class Place(NamedTuple):
    """Measurements of the six faces of one optical centre.

    Attributes:
        center: (3,) metres.
        steps: (12,) levels across the edges, less those inside faces.
        gains: factors of light that would bring faces together.
        slips: by face, the turn (3,) radians by which it is off, proven on two edges.
        names: of the directions that faces look in.
    """

    center: Array
    steps: Array
    gains: Gains
    slips: dict[int, Array]
    names: list[str]


def examine_recording(source: Source, picture: Path | None = None) -> list[Finding]:
    """Return findings about seams, exposure, vignette and slips of a recording's cubes in colour.

    Views with depth from several centres are examined for faults of poses and depth, too.

    Args:
        source: of the recording.
        picture: a PNG to write: the worst edge, between the two faces that meet there.
    """
    transfer = "srgb" if source.capabilities.transfer == "unknown" else source.capabilities.transfer
    others = [*_masks(source), *examine_views(source)]
    places = [_measured(cube, transfer) for cube in _cubes(source)]
    if not places:
        return [Finding("seams", "no cube of six faces in colour"), *others]
    steps = np.concatenate([place.steps for place in places])
    worst = max(places, key=lambda place: float(place.steps.max()))
    at = ", ".join(f"{value:.4g}" for value in worst.center)
    value = (
        f"{len(places)} cubes: steps across edges {np.median(steps):.2f} levels (median), "
        f"{np.quantile(steps, 0.9):.1f} (90 %), {steps.max():.1f} at ({at}) m"
    )
    if picture is not None:
        _draw_worst_edge(source, worst, picture)
    verdict: Literal["warning", "bad"] = "warning" if steps.max() <= _BAD_STEP else "bad"
    remedy = f"{_AT_SOURCE}; or render with seams: close"
    seams = Finding.unless(bool(steps.max() <= _STEP), "seams", value, verdict, remedy)
    vignette = pooled_vignette(islice(_cubes(source), POOLED), transfer)
    return [seams, _exposure(places), _vignette(vignette), *_slips(places), *others]


def _draw_worst_edge(source: Source, worst: Place, picture: Path) -> None:
    """Write the pixels on both sides of the worst edge of a centre, which is the line in the middle."""
    cube = Cube.recorded(source, worst.center, source.state)
    assert cube is not None
    a, b = cube.lines(cube.edges[int(worst.steps.argmax())], _DRAWN_PX)
    with whole_file(picture) as part:
        part.write_bytes(png.encode(np.concatenate([a[::-1], b]).astype(np.uint8)))


def _cubes(source: Source) -> Iterator[Cube]:
    """Yield the cubes in colour of a recording."""
    recorded = source.recorded()
    if recorded is None:
        return
    for center in recorded.centers():
        if cube := Cube.recorded(source, np.array(center), source.state):
            yield cube


def _measured(cube: Cube, transfer: str) -> Place:
    return Place(
        center=cube.views[0].pose.position,
        steps=cube.steps(),
        gains=estimate_gains(cube, transfer),
        slips=proven_turns(cube),
        names=[_direction(view.pose.R_w_c[:, 2]) for view in cube.views],
    )


def _direction(axis_w: Array) -> str:
    """Return the name of the face, aligned with the world, that looks most along an axis (3,)."""
    return max(cube_rotations(), key=lambda face: float(axis_w @ face[1][:, 2]))[0]


def _masks(source: Source) -> Iterator[Finding]:
    """Yield what object masks show, if there are any: objects, or nothing that has a name."""
    if "object_mask" not in source.capabilities.modes:
        return
    table = source.objects()
    shown = 0
    known = 0
    for view in source.recorded_views() or ():
        with suppress(MissingCaptureError):
            (capture,) = source.capture([Request(view, "object_mask", source.state)])
            if capture.pixels.ndim == 2:
                labels, _ = labels_of_ids(capture.pixels, table)
            else:
                labels, _ = labels_of(capture.pixels, table)
            shown += labels.size
            known += int(np.count_nonzero(labels))
    value = f"{known} of {shown} pixels show one of {len(table.names())} objects"
    yield Finding.unless(known > 0, "masks", value, "bad", "import it with --names")


def _exposure(places: Sequence[Place]) -> Finding:
    drifts = []  # quotients of the greatest and the least gain, of places where they are proven
    for place in places:
        gains = place.gains.gains
        if place.gains.proven:
            drifts.append(float(gains.max() / gains.min()))
    if not drifts:
        explained = max(place.gains.explained for place in places)
        return Finding("exposure", f"explains {100 * explained:.0f} % of the steps at most")
    value = (
        f"differs by up to {max(drifts):.3g} between faces of one centre, at {len(drifts)} of {len(places)}"
    )
    return Finding("exposure", value, "warning", "record with manual exposure; or render with seams: gains")


def _vignette(pooled: tuple[float, float] | None) -> Finding:
    if pooled is None:
        return Finding("vignette", "none is proven")
    lost = -np.expm1(-2 * pooled[0] - 4 * pooled[1])
    remedy = "record without vignette; or render with seams: gains"
    return Finding("vignette", f"corners {lost:.0%} darker than the middle", "warning", remedy)


def _slips(places: Sequence[Place]) -> Iterator[Finding]:
    by_face: dict[str, list[float]] = {}
    for place in places:
        for face, turn in place.slips.items():
            by_face.setdefault(place.names[face], []).append(float(np.degrees(np.linalg.norm(turn))))
    remedy = "check the pose that was set against the one that was captured"
    for name, angles in by_face.items():
        value = f"the {name} face is turned by {np.median(angles):.2f} degrees"
        yield Finding("slip", f"{value} at {len(angles)} of {len(places)}", "warning", remedy)
