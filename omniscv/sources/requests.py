"""Views, requests and captures, delivered in order; captures at several exposures, merged to light."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv import modalities
from omniscv.arguments import numbers, one_of, shown
from omniscv.errors import ArgumentError, BadReplyError, SourceError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.modalities import TRANSFERS

_POSE_DECIMALS = 7
"""Of metres, degrees and matrix entries: views that agree to these decimals are equal. 1e-7 rad is a
ten-thousandth of a pixel at f = 1024; servers print three decimals of a centimetre."""

LONGEST_STATE = 100  # characters
MOST_STOPS = 20.0


class ViewKey(NamedTuple):
    """The numbers of a view, rounded: equal views have equal keys; ``rotation`` is ``R_w_c``, row by row."""

    width: int
    height: int
    position: tuple[float, ...]
    rotation: tuple[float, ...]
    fov_deg: float
    lens: tuple[float, ...] = ()


class Lens(NamedTuple):
    """How a picture differs from square pixels whose optical axis is in the middle; the same at every size.

    ``squeeze`` is the focal length down, in px, as a part of that across; ``x``, ``y`` the principal point,
    right of and below the middle, in widths and heights.
    """

    squeeze: float = 1.0
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True, eq=False)
class View:
    """One perspective picture: a pose, a horizontal field of view in (0, 180), a size of at least 1 x 1 px.

    The picture's frame is the pose's camera frame (x right, y down, z forward); a point is seen at
    ``u = W/2 + f x/z``, ``v = H/2 + f y/z`` with ``f = (W/2) / tan(fov/2)``, pixel centres at +0.5. With a
    lens it is seen at ``u = W (1/2 + lens.x) + f x/z``, ``v = H (1/2 + lens.y) + lens.squeeze f y/z``.

    Raises:
        ArgumentError: a field of view, size or lens outside its domain.
    """

    pose: Pose
    fov_deg: float
    width: int
    height: int
    lens: Lens | None = None

    def __post_init__(self) -> None:
        if not 0 < self.fov_deg < 180:
            raise ArgumentError(f"fov_deg: expected 0 < fov_deg < 180, got {self.fov_deg!r}")
        if not (self.width >= 1 and self.height >= 1):
            raise ArgumentError(f"size: expected at least 1 x 1 px, got {self.width} x {self.height}")
        if self.lens is not None and not (self.lens.squeeze > 0 and np.isfinite(self.lens).all()):
            raise ArgumentError(f"lens: expected finite numbers and squeeze > 0, got {self.lens}")

    @property
    def focal_px(self) -> float:
        """Focal length in px: across, and also down unless a lens squeezes the picture."""
        return pinhole.focal_px(self.width, self.fov_deg)

    @property
    def projection(self) -> pinhole.Projection:
        """Focal lengths and principal point, px."""
        squeeze, x, y = self.lens or Lens()
        focal = self.focal_px
        center = (self.width / 2 + self.width * x, self.height / 2 + self.height * y)
        return pinhole.Projection(focal, focal * squeeze, *center)

    def scaled(self, factor: int) -> Self:
        """Return the view with ``factor`` times as many pixels each way."""
        return self if factor == 1 else replace(self, width=factor * self.width, height=factor * self.height)

    def project(self, points_w: ArrayLike) -> Array:
        """Project (..., 3) world points to (..., 3): u, v in px, planar depth z in m (z <= 0: behind)."""
        return pinhole.project(self.pose.to_camera(points_w), self.projection)

    def ray_lengths(self) -> Array:
        """Return (H, W) ray lengths to pixel centres per metre of planar depth: ``|(x/z, y/z, 1)|``."""
        return pinhole.ray_lengths(self.projection, self.width, self.height)

    def directions_w(self) -> Array:
        """Return (H, W, 3) unit rays to pixel centres, world frame."""
        pixels = np.stack(np.meshgrid(np.arange(self.width), np.arange(self.height)), axis=-1) + 0.5
        rays_c = pinhole.rays(pixels, self.projection) / self.ray_lengths()[..., None]
        return np.asarray(rays_c @ self.pose.R_w_c.T)

    def key(self) -> ViewKey:
        """Return the view's numbers, rounded."""
        return self._key

    @cached_property
    def _key(self) -> ViewKey:
        numbers = np.concatenate([self.pose.position, self.pose.rotation.ravel(), [self.fov_deg]])
        rounded = (np.round(numbers, _POSE_DECIMALS) + 0.0).tolist()  # + 0.0: no negative zero
        lens = tuple(round(number, _POSE_DECIMALS) for number in self.lens or ())
        return ViewKey(self.width, self.height, tuple(rounded[:3]), tuple(rounded[3:12]), rounded[12], lens)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, View) and self.key() == other.key()

    def __hash__(self) -> int:
        return hash(self.key())


class Traced(NamedTuple):
    """What rays meet.

    Attributes:
        distance: (...) float64 metres along the unit rays, +inf where they meet nothing.
        label: (...) uint16 of the objects (:class:`omniscv.sources.ObjectTable`), 0 for none.
        normal: (..., 3) float64 unit vectors in the world frame, towards the ray; 0 for none.
    """

    distance: Array
    label: NDArray[np.uint16]
    normal: Array


@dataclass(frozen=True)
class Request:
    """A view in a mode, of the world in a state.

    Attributes:
        view: what is captured.
        mode: a modality that sources deliver; of an alias, the modality's name is kept.
        state: of the world (:attr:`omniscv.geometry.instant.Instant.state`); empty for a still one.
        again: whether it repeats a capture to compare the two; such a capture is neither taken from a
            recording nor added to it.
        stops: of colours, exposed for 2^stops times as long as the source's own exposure; None for that one.

    Raises:
        ArgumentError: an unknown modality, a state that is no short text, or stops of another modality.
    """

    view: View
    mode: str
    state: str = ""
    again: bool = False
    stops: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mode", *modalities.chosen((self.mode,)))
        if self.stops is not None and (self.mode != "lit" or not abs(self.stops) <= MOST_STOPS):
            expected = f"expected none, or {-MOST_STOPS:g} to {MOST_STOPS:g} of lit"
            raise ArgumentError(f"stops: {expected}, got {shown(self.stops)} of {self.mode}")
        if not isinstance(self.state, str) or len(self.state) > LONGEST_STATE:
            expected = f"expected a text of at most {LONGEST_STATE} characters"
            raise ArgumentError(f"state: {expected}, got {shown(self.state)}")

    def check_state(self, state: str, where: str) -> None:
        """Raise ArgumentError for another state than a source's, whose address is ``where``."""
        if self.state != state:
            expected = f"expected requests of the world as it is, state {shown(state)}"
            raise ArgumentError(f"{where}: {expected}, got state {shown(self.state)}; plan anew, or use at()")


@dataclass(frozen=True, eq=False)
class Capture:
    """What a source delivers for a request.

    Attributes:
        request: what was requested.
        view: what was captured, the view that rays are looked up in. It differs from ``request.view`` where
            the source cannot capture exactly that.
        pixels: read-only, (H, W) or (H, W, C) as :mod:`omniscv.modalities` has it. Depth is planar, in
            metres, +inf for no surface; normals are unit vectors in the world frame, 0 where unknown. Object
            masks are RGB colours, or uint16 (H, W) instance ids that the source's :class:`ObjectTable` names.
        provenance: server, scene, command, time: plain JSON values.
        payload: the bytes as received, for sources with a wire.
        encoding: the codec of :mod:`omniscv.sources.codecs` that decodes ``payload`` to ``pixels``, or would.
        marks: (H, W) of its development (:mod:`omniscv.sources.developing`), 255 where set: ``relit``, or
            ``sky``.
    """

    request: Request
    view: View
    pixels: NDArray[Any]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    payload: bytes | None = None
    encoding: str | None = None
    marks: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)

    @property
    def mode(self) -> str:
        """The request's mode."""
        return self.request.mode


Held = Callable[[], Capture]
"""Returns a capture that exists already. It is called at delivery, so that no pixels are read too early."""

_MOST_KNOWN_IN_A_ROW = 24
"""After so many requests in a row whose captures exist, those that wait are delivered before more requests
are read: a stream of requests is not read to its end before its first capture is delivered."""


def in_order(
    requests: Iterable[Request],
    find: Callable[[Request], Held | None],
    capture: Callable[[Iterable[Request]], Iterator[Capture]],
) -> Iterator[Capture]:
    """Yield one capture per request, in the order of the requests.

    Args:
        requests: read lazily, by ``capture``.
        find: returns what delivers the capture of a request that exists already, None where a new one is
            needed; called once for each request, when it is read.
        capture: makes the captures that do not exist, in their order.

    Raises:
        SourceError: ``capture`` delivered too few.
    """
    remaining = iter(requests)
    waiting: deque[Held | None] = deque()  # None stands for the next new capture

    def missing() -> Iterator[Request]:
        known_in_a_row = 0
        while known_in_a_row < _MOST_KNOWN_IN_A_ROW and (request := next(remaining, None)):
            deliver = find(request)
            waiting.append(deliver)
            if deliver is None:
                known_in_a_row = 0
                yield request
            else:
                known_in_a_row += 1

    while True:
        for new in capture(missing()):
            while deliver := waiting.popleft():
                yield deliver()
            yield new
        if not waiting:
            return
        while waiting:
            deliver = waiting.popleft()
            if deliver is None:
                raise SourceError("source: expected a capture for each request, got too few")
            yield deliver()


Response = str | NDArray[np.float64]
"""What codes mean: a transfer, or the light (256,) of each code."""


def exposures_of(request: Request, stops: Iterable[float]) -> list[Request]:
    """Return a request of each of some ``stops`` for a ``request`` of colours; any other one alone."""
    if request.mode != "lit" or request.stops is not None:
        return [request]
    return [replace(request, stops=stop) for stop in stops]


def merge_exposures(request: Request, captures: Sequence[Capture]) -> Capture:
    """Return light, float32, of one view's ``captures`` at several exposures in 8 bits of known response.

    It is the capture for the ``request`` of colours whose exposures they are.
    """
    from omniscv import light  # compiled; sources are imported without numba

    first = captures[0]
    shapes = {(capture.pixels.shape, capture.pixels.dtype.name) for capture in captures}
    if len(shapes) > 1 or first.pixels.dtype != np.uint8:
        raise BadReplyError(f"expected exposures of one size in 8 bits, got {sorted(shapes)}")
    stops = [capture.request.stops or 0.0 for capture in captures]
    pixels = light.merge([capture.pixels for capture in captures], stops, response_of(first.provenance))
    pixels.flags.writeable = False
    provenance = dict(first.provenance)
    provenance.pop("transfer", None)
    provenance.pop("response", None)
    provenance["stops"] = stops
    return Capture(request, first.view, pixels, provenance)


def response_of(provenance: Any) -> Response:
    """Return the response in a capture's provenance; ArgumentError if there is none."""
    recorded = provenance.get("response")
    if recorded is None:
        known = [name for name in TRANSFERS if name != "unknown"]
        return str(one_of("transfer", provenance.get("transfer"), known))
    response = numbers("response", recorded, (256,))
    if response[0] < 0 or (np.diff(response) < 0).any():
        raise ArgumentError(f"response: expected light that increases with its code, got {shown(recorded)}")
    return response
