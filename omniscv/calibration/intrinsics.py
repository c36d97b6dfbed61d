"""Cameras as named numbers, as calibration files hold them.

Forms name the numbers as we do, or by names of :data:`DERIVED`.
"""

import math
from collections.abc import Callable, Iterable, Mapping
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

_LIMITS = {"fx": (1e-3, 1e5), "fy": (1e-3, 1e5), "cx": (-100.0, 100.0), "cy": (-100.0, 100.0)}
"""Least and largest focal length and principal point of a picture, in longer sides of the image."""


Sized = Callable[[Numbers, int, int], float]
"""A number by our numbers so far, and the width and height of the image, px."""

_SIZES = ("W", "H", "W/2", "H/2")
"""Names of numbers of files that are no camera's but the image's."""


class Derived(NamedTuple):
    """A number of files from which some of ours follow: ``ours = scale * number + offset``.

    Attributes:
        sets: our numbers that it sets; the last one is written.
        covers: our numbers that it alone holds, so that they must be equal.
        scale: by our numbers so far, and the size.
        offset: the same.
    """

    sets: tuple[str, ...]
    covers: tuple[str, ...]
    scale: Sized = lambda ours, width, height: 1.0
    offset: Sized = lambda ours, width, height: 0.0

    def read(self, value: float, ours: Numbers, width: int, height: int) -> Numbers:
        """Return our numbers of a value.

        Args:
            value: as the file has it.
            ours: our numbers so far.
            width: of the image, px.
            height: of the image, px.
        """
        number = value * self.scale(ours, width, height) + self.offset(ours, width, height)
        return dict.fromkeys(self.sets, number)

    def write(self, ours: Numbers, width: int, height: int) -> float | None:
        """Return the value of our numbers; None where those that it covers differ.

        Args:
            ours: all numbers of the camera.
            width: of the image, px.
            height: of the image, px.
        """
        if not self.covers:
            return 0.0
        covered = [ours.get(name, 0.0) for name in self.covers]
        if any(number != covered[-1] for number in covered):
            return None
        return (covered[-1] - self.offset(ours, width, height)) / self.scale(ours, width, height)


def _longer_side(ours: Numbers, width: int, height: int) -> float:
    """Return OpenSfM's unit of lengths in an image, px."""
    return max(width, height)


_FOCALS = ("fx", "fy")
DERIVED = {
    "f": Derived(_FOCALS, _FOCALS),
    # K[0, 1], px
    "s": Derived(("skew",), ("skew",), lambda ours, width, height: 1 / (ours["fx"] or math.nan)),
    "ratio": Derived(("fy",), ("fy",), lambda ours, width, height: ours["fx"]),
    # from the middle of the image, px
    "du": Derived(("cx",), ("cx",), offset=lambda ours, width, height: width / 2),
    "dv": Derived(("cy",), ("cy",), offset=lambda ours, width, height: height / 2),
    # the same of a file that puts pixel centres at whole numbers
    "du0": Derived(("cx",), ("cx",), offset=lambda ours, width, height: width / 2 + HALF_PIXEL),
    "dv0": Derived(("cy",), ("cy",), offset=lambda ours, width, height: height / 2 + HALF_PIXEL),
    # Metashape: one focal length, and what fx has more
    "f_y": Derived(_FOCALS, ("fy",)),
    "b1": Derived(("fx",), ("fx",), offset=lambda ours, width, height: ours["fy"]),
    # OpenSfM: in units of the longer side, from the middle
    "nf": Derived(_FOCALS, _FOCALS, _longer_side),
    "nfx": Derived(("fx",), ("fx",), _longer_side),
    "nfy": Derived(("fy",), ("fy",), _longer_side),
    "ncx": Derived(
        ("cx",),
        ("cx",),
        _longer_side,
        lambda ours, width, height: width / 2,
    ),
    "ncy": Derived(
        ("cy",),
        ("cy",),
        _longer_side,
        lambda ours, width, height: height / 2,
    ),
    "mm": Derived(_FOCALS, _FOCALS, lambda ours, width, height: width / (ours["sensor"] or math.nan)),
    # the farthest angle off the axis: twice it in degrees, and in radians
    "fov": Derived(("most",), ("most",), lambda ours, width, height: 0.5),
    "rad": Derived(("most",), ("most",), lambda ours, width, height: 180 / math.pi),
    "_": Derived((), ()),
}
"""By the name that :mod:`omniscv.calibration.keys` has for the number of the file."""


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
        u, v = camera.center.tolist()
        return [Intrinsics(camera.name, {"cx": u, "cy": v})]
    if camera.name == "fisheye-equidistant":
        return [Intrinsics("kannala-brandt", ours)]
    if camera.name == "fisheye-stereographic":  # the sphere model seen from its pole, where f = 2 focal
        unified = Intrinsics("unified", {**ours, "fx": 2 * ours["fx"], "fy": 2 * ours["fy"], "xi": 1.0})
        return [unified, _extended(unified)]
    is_inverse = getattr(camera, "reference", "") == "pixel-to-angle"
    exact = Intrinsics(f"{camera.name}-inverse" if is_inverse else camera.name, ours)
    is_distorted = any(ours.get(name) for name in ("skew", "k1", "k2", "p1", "p2"))
    if camera.name == "unified" and not is_distorted:
        return [exact, _extended(exact)]
    return [exact]


def _extended(unified: Intrinsics) -> Intrinsics:
    """Return the unified model as the extended one: ``alpha = xi / (1 + xi)``, beta 1, f times ``1 -
    alpha``."""
    numbers = dict(unified.numbers)
    xi = numbers.pop("xi")
    alpha = xi / (1 + xi)
    numbers["fx"] = (1 - alpha) * numbers["fx"]
    numbers["fy"] = (1 - alpha) * numbers["fy"]
    return Intrinsics("extended-unified", {**numbers, "alpha": alpha, "beta": 1.0})


def camera_of(model: str, width: int, height: int, numbers: Mapping[str, float]) -> Camera:
    """Return the camera of a model and its numbers.

    Args:
        model: as in :class:`Intrinsics`.
        width: of the image, px.
        height: of the image, px.
        numbers: as in :class:`Intrinsics`; those missing are 0.

    Raises:
        ArgumentError: numbers that the model or a picture of that size cannot have.
    """
    name = model.removesuffix("-inverse")
    lens = cameras.model(name).lens
    assert lens is not None
    check_limits({key: numbers[key] for key in lens.names if key in _LIMITS}, max(width, height))
    arguments = lens.arguments(numbers)
    if name == "ftheta":
        arguments["reference"] = "pixel-to-angle" if name != model else "angle-to-pixel"
        if abs(arguments["max_angle_deg"] - 180) < 1e-9:
            arguments["max_angle_deg"] = None
    return cameras.create(name, width, height, **arguments)


def check_limits(numbers: Numbers, longer: int) -> None:
    """Raise ArgumentError for a focal length or a centre that no picture can have.

    Args:
        numbers: of a camera, px by name.
        longer: the longer side of its image, px.
    """
    for name, (least, most) in _LIMITS.items():
        if name in numbers:
            number(name, numbers[name], least=least * longer, most=most * longer)


def complete(values: Mapping[str, float], width: int, height: int, shift_px: float) -> Numbers:
    """Return our numbers of those that a file has.

    Args:
        values: by the names of :mod:`omniscv.calibration.keys`, in the order in which they were read.
        width: of the image, px.
        height: of the image, px.
        shift_px: what is added to ``cx`` and ``cy`` to make them ours.

    Raises:
        ArgumentError: the file has another size of the image as a number of the model.
    """
    size = {"W": width, "H": height}
    ours: Numbers = {}
    for name, value in values.items():
        if name not in DERIVED and name not in _SIZES:
            ours[name] = value + shift_px if name in ("cx", "cy") else value
    for name, value in values.items():
        if name in DERIVED:
            ours |= DERIVED[name].read(value, ours, width, height)
        if name in size and value != size[name]:
            raise ArgumentError(f"expected the image size, {width} {height}, got {value:.15g}")
    return {"cx": width / 2, "cy": height / 2, **ours}


def file_numbers(names: Iterable[str], ours: Numbers, width: int, height: int, shift_px: float) -> Numbers:
    """Return the numbers that a file has for ours, the inverse of :func:`complete`.

    Args:
        names: of the numbers that the file's model has, as in :mod:`omniscv.calibration.keys`.
        ours: all numbers of the camera.
        width: of the image, px.
        height: of the image, px.
        shift_px: what is taken from ``cx`` and ``cy``.

    Raises:
        ArgumentError: the model lacks one of our numbers that is not neutral, or has one for two that differ.
    """
    names = list(names)
    covered: set[str] = set()
    for name in names:
        covered.update(DERIVED[name].covers if name in DERIVED else [name])
    values: Numbers = {"cx": width / 2, "cy": height / 2, **NEUTRAL}
    for name, value in ours.items():
        neutral = values.get(name, 0.0)
        if name not in covered and value != neutral:
            raise ArgumentError(f"{name}: expected {neutral:.6g}, got {value:.6g}")
    sizes = {"W": width, "H": height, "W/2": width / 2, "H/2": height / 2}
    for name in names:
        if name in sizes:
            values[name] = sizes[name]
        elif name in DERIVED:
            value_of_file = DERIVED[name].write(ours, width, height)
            if value_of_file is None:
                covers = " ".join(DERIVED[name].covers)
                raise ArgumentError(f"{covers}: expected the same numbers, got others")
            values[name] = value_of_file
        else:
            value = ours.get(name, 0.0)
            values[name] = value - shift_px if name in ("cx", "cy") else value
    return values


def refuse_limit(camera: Camera) -> None:
    """Raise ArgumentError where the camera has a limit ``fov_deg``, which no format holds."""
    limit = getattr(camera, "fov_deg", None)
    if limit is not None:
        wanted = "expected a camera without this limit, which the format cannot carry"
        raise ArgumentError(f"fov_deg: {wanted}, got {limit:.15g}; save the same camera made without fov_deg")


def check_first_is_origin(mounts: Mapping[str, RigCamera], program: str) -> None:
    """Raise ArgumentError where the first camera is not the rig's frame.

    Args:
        mounts: the rig's cameras by name.
        program: whose format needs it, for the message.
    """
    name, first = next(iter(mounts.items()))
    offset = max(np.abs(first.pose.position).max(), np.abs(first.pose.rotation - np.eye(3)).max())
    if offset > 1e-12:
        wanted = "expected a rig in the frame of its first camera"
        raise ArgumentError(f"{program}: {wanted}, got another frame; save rig.seen_from({name!r})")
