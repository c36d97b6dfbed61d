"""Cameras as named numbers, as calibration files hold them.

Forms name the numbers as we do, or by names of :data:`DERIVED`.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from typing import NamedTuple

import numpy as np

from omniscv import cameras
from omniscv.arguments import number
from omniscv.cameras import Camera
from omniscv.cameras.lens_parameters import NEUTRAL, Numbers
from omniscv.cameras.rig import RigCamera
from omniscv.errors import ArgumentError

HALF_PIXEL = 0.5
"""Added to a principal point of a format that puts pixel centres at whole numbers; ours are at .5."""

_LIMITS = dict.fromkeys(("fx", "fy"), (1e-3, 1e5)) | dict.fromkeys(("cx", "cy"), (-100.0, 100.0))
"""Least and largest focal length and principal point of a picture, in longer sides of the image."""


class Derived(NamedTuple):
    """A number of files that is one of ours times ``scale`` and more by ``offset``.

    Attributes:
        sets: names of our numbers that it sets; the last one is written.
        covers: those that it holds alone: all must be equal.
        scale, offset: of our numbers so far, and of the size.
    """

    sets: str
    covers: str
    scale: Callable[[Numbers, int, int], float] = lambda n, w, h: 1.0
    offset: Callable[[Numbers, int, int], float] = lambda n, w, h: 0.0

    def read(self, value: float, numbers: Numbers, *size: int) -> Numbers:
        """Return our numbers of a value."""
        ours = value * self.scale(numbers, *size) + self.offset(numbers, *size)
        return dict.fromkeys(self.sets.split(), ours)

    def write(self, numbers: Numbers, *size: int) -> float | None:
        """Return the value; None where our numbers differ."""
        ours = [numbers.get(name, 0.0) for name in (self.covers or self.sets).split()]
        value = (ours[-1] - self.offset(numbers, *size)) / self.scale(numbers, *size) if ours else 0.0
        return value if ours == ours[-1:] * len(ours) else None


DERIVED = {
    "f": Derived("fx fy", "fx fy"),
    "s": Derived("skew", "skew", lambda n, w, h: 1 / (n["fx"] or math.nan)),  # K[0, 1], px
    "ratio": Derived("fy", "fy", lambda n, w, h: n["fx"]),
    "du": Derived("cx", "cx", offset=lambda n, w, h: w / 2),  # from the middle of the image
    "dv": Derived("cy", "cy", offset=lambda n, w, h: h / 2),
    "du0": Derived("cx", "cx", offset=lambda n, w, h: w / 2 + HALF_PIXEL),  # centres at whole numbers
    "dv0": Derived("cy", "cy", offset=lambda n, w, h: h / 2 + HALF_PIXEL),
    "f_y": Derived("fx fy", "fy"),  # Metashape: one focal length, and what fx has more
    "b1": Derived("fx", "fx", offset=lambda n, w, h: n["fy"]),
    "nf": Derived("fx fy", "fx fy", lambda n, w, h: max(w, h)),  # OpenSfM: in units of the longer side
    "nfx": Derived("fx", "fx", lambda n, w, h: max(w, h)),
    "nfy": Derived("fy", "fy", lambda n, w, h: max(w, h)),
    "ncx": Derived("cx", "cx", lambda n, w, h: max(w, h), lambda n, w, h: w / 2),
    "ncy": Derived("cy", "cy", lambda n, w, h: max(w, h), lambda n, w, h: h / 2),
    "mm": Derived("fx fy", "fx fy", lambda n, w, h: w / (n["sensor"] or math.nan)),
    "fov": Derived("most", "most", lambda n, w, h: 0.5),
    "rad": Derived("most", "most", lambda n, w, h: 180 / math.pi),
    "_": Derived("", ""),
}
"""By name in the tables of forms."""


class Intrinsics(NamedTuple):
    """A model's name, and the numbers of ``Camera.lens``: px by our pixel rule."""

    model: str
    numbers: Numbers


def intrinsics(camera: Camera) -> list[Intrinsics]:
    """Return the models that have a camera's rays, and their numbers; its own model comes first.

    The image circle of lenses such as ``fisheye-equidistant`` is not among these numbers, nor the limit
    ``fov_deg``: see :func:`refuse_limit`.
    """
    ours = camera.lens.numbers(camera) if camera.lens is not None else None
    if ours is None:
        return []
    if camera.name == "equirectangular":
        return [Intrinsics(camera.name, dict(zip(("cx", "cy"), camera.center.tolist(), strict=True)))]
    if camera.name == "fisheye-equidistant":
        return [Intrinsics("kannala-brandt", ours)]
    if camera.name == "fisheye-stereographic":  # the sphere model seen from its pole, where f = 2 focal
        unified = Intrinsics("unified", {**ours, "fx": 2 * ours["fx"], "fy": 2 * ours["fy"], "xi": 1.0})
        return [unified, _extended(unified)]
    inverse = getattr(camera, "reference", "") == "pixel-to-angle"
    exact = Intrinsics(camera.name + "-inverse" * inverse, ours)
    distorted = any(ours.get(name) for name in ("skew", "k1", "k2", "p1", "p2"))
    return [exact, _extended(exact)] if camera.name == "unified" and not distorted else [exact]


def _extended(unified: Intrinsics) -> Intrinsics:
    """Return the unified model as the extended one with ``beta`` = 1."""
    numbers = unified.numbers
    alpha = numbers["xi"] / (1 + numbers["xi"])
    scaled = {name: (1 - alpha) * numbers[name] for name in ("fx", "fy")}
    kept = {name: value for name, value in numbers.items() if name != "xi"}
    return Intrinsics("extended-unified", {**kept, **scaled, "alpha": alpha, "beta": 1.0})


def camera_of(model: str, width: int, height: int, numbers: Mapping[str, float]) -> Camera:
    """Return the camera of a model with numbers as :class:`Intrinsics` has them; those missing are 0."""
    name = model.removesuffix("-inverse")
    lens = cameras.model(name).lens
    assert lens is not None
    check_limits({each: numbers[each] for each in lens.names if each in _LIMITS}, max(width, height))
    arguments = lens.arguments(numbers)
    if name == "ftheta":
        arguments["reference"] = "pixel-to-angle" if name != model else "angle-to-pixel"
        if abs(arguments["max_angle_deg"] - 180) < 1e-9:
            arguments["max_angle_deg"] = None
    return cameras.create(name, width, height, **arguments)


def check_limits(numbers: Numbers, longer: int) -> None:
    """Refuse focal lengths and centres that no picture with such a longer side, px, can have."""
    for name in (each for each in _LIMITS if each in numbers):
        least, most = _LIMITS[name]
        number(name, numbers[name], least=least * longer, most=most * longer)


def complete(values: Mapping[str, float], width: int, height: int, shift_px: float) -> Numbers:
    """Return our numbers of those of a form; ``shift_px`` is added to the principal point."""
    size = {"W": width, "H": height}
    ours = {name: value for name, value in values.items() if name not in DERIVED and name[0] not in "WH"}
    for name in {"cx", "cy"} & ours.keys():
        ours[name] += shift_px
    for name, value in values.items():
        if name in DERIVED:
            ours |= DERIVED[name].read(value, ours, width, height)
        if name in size and value != size[name]:
            raise ArgumentError(f"expected the image size, {width} {height}, got {value:.15g}")
    return {"cx": width / 2, "cy": height / 2, **ours}


def held(names: Iterable[str], ours: Numbers, width: int, height: int, shift_px: float) -> Numbers:
    """Return a form's numbers, the inverse of :func:`complete`; ArgumentError where it cannot hold ours."""
    names = list(names)
    covers = (DERIVED[name].covers.split() if name in DERIVED else [name] for name in names)
    covered = {*chain.from_iterable(covers)}
    values: Numbers = {"cx": width / 2, "cy": height / 2, **NEUTRAL}
    for name, value in ours.items():
        if name not in covered and value != values.get(name, 0.0):
            raise ArgumentError(f"{name}: expected {values.get(name, 0.0):.6g}, got {value:.6g}")
    sizes = {"W": width, "H": height, "W/2": width / 2, "H/2": height / 2}
    for name in names:
        own = DERIVED[name].write(ours, width, height) if name in DERIVED else ours.get(name, 0.0)
        if own is None:
            raise ArgumentError(f"{DERIVED[name].covers}: expected the same numbers, got others")
        values[name] = sizes.get(name, own - (shift_px if name in ("cx", "cy") else 0.0))
    return values


def refuse_limit(camera: Camera) -> None:
    """Raise ArgumentError where the camera has a limit ``fov_deg``, which no format holds."""
    limit = getattr(camera, "fov_deg", None)
    if limit is not None:
        wanted = "expected a camera without this limit, which the format cannot carry"
        raise ArgumentError(f"fov_deg: {wanted}, got {limit:.15g}; save the same camera made without fov_deg")


def check_first_is_origin(mounts: Mapping[str, RigCamera], program: str) -> None:
    """Raise ArgumentError where the first camera is not the rig's frame."""
    name, first = next(iter(mounts.items()))
    offset = max(np.abs(first.pose.position).max(), np.abs(first.pose.rotation - np.eye(3)).max())
    if offset > 1e-12:
        wanted = "expected a rig in the frame of its first camera"
        raise ArgumentError(f"{program}: {wanted}, got another frame; save rig.seen_from({name!r})")
