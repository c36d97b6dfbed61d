"""Cameras as named numbers, as calibration files hold them.

Forms name the numbers as we do, or by names of :data:`DERIVED`. What the forms share is here too: values from
untrusted text, and the one camera of a file.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import numpy as np

from omniscv import arguments
from omniscv.arguments import number, shown, within
from omniscv.cameras import Camera, create
from omniscv.cameras.rig import RigCamera
from omniscv.errors import ArgumentError
from omniscv.records import key_of, mapping, read
from omniscv.storage.bounded import parse_yaml

HALF_PIXEL = 0.5
"""Added to a principal point of a format that puts pixel centres at whole numbers; ours are at .5."""

_ARGUMENTS: dict[str, dict[str, str]] = {
    "pinhole": {"skew": "skew", "distortion": "k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4"},
    "kannala-brandt": {"skew": "skew", "k": "k1 k2 k3 k4"},
    "fisheye624": {"skew": "skew", "k": "k0 k1 k2 k3 k4 k5", "p": "p0 p1", "s": "s0 s1 s2 s3"},
    "unified": {"skew": "skew", "xi": "xi", "distortion": "k1 k2 p1 p2"},
    "extended-unified": {"skew": "skew", "alpha": "alpha", "beta": "beta"},
    "double-sphere": {"skew": "skew", "xi": "xi", "alpha": "alpha"},
    "division": {"k": "k"},
    "scaramuzza": {"coefficients": "a0 a1 a2 a3 a4", "affine": "c d e"},
    "ftheta": {"polynomial": "c0 c1 c2 c3 c4 c5"},
    "equirectangular": {},
}
"""By model: the constructor arguments beyond size, focal lengths and centre, and the numbers of each."""

MODELS = tuple(_ARGUMENTS)
"""The models that such numbers describe."""

_FOCAL = (1e-3, 1e5)
"""Least and largest focal length, in longer sides of the image, that a picture can have."""
_FARTHEST_CENTER = 100
"""Of the principal point, in longer sides of the image."""

Numbers = dict[str, float]


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


def _longer(numbers: Numbers, width: int, height: int) -> float:
    return float(max(width, height))


def _middle_u(numbers: Numbers, width: int, height: int) -> float:
    return width / 2


def _middle_v(numbers: Numbers, width: int, height: int) -> float:
    return height / 2


DERIVED = {
    "f": Derived("fx fy", "fx fy"),
    "s": Derived("skew", "skew", lambda n, w, h: 1 / (n["fx"] or math.nan)),  # K[0, 1], px
    "ratio": Derived("fy", "fy", lambda n, w, h: n["fx"]),
    "du": Derived("cx", "cx", offset=_middle_u),  # from the middle of the image
    "dv": Derived("cy", "cy", offset=_middle_v),
    "f_y": Derived("fx fy", "fy"),  # Metashape: one focal length, and what fx has more
    "b1": Derived("fx", "fx", offset=lambda n, w, h: n["fy"]),
    "nf": Derived("fx fy", "fx fy", _longer),  # OpenSfM: in units of the longer side, from the middle
    "nfx": Derived("fx", "fx", _longer),
    "nfy": Derived("fy", "fy", _longer),
    "ncx": Derived("cx", "cx", _longer, _middle_u),
    "ncy": Derived("cy", "cy", _longer, _middle_v),
    "_": Derived("", ""),
}
"""By name in the tables of forms."""

T = TypeVar("T")


class Intrinsics(NamedTuple):
    """A model's name, and its numbers: fx, fy, cx, cy (px, our pixel rule) and those of ``_ARGUMENTS``."""

    model: str
    numbers: Numbers


def intrinsics(camera: Camera) -> list[Intrinsics]:
    """Return the models that have a camera's rays, and their numbers; its own model comes first.

    The image circle of lenses such as ``fisheye-equidistant`` is not among these numbers.

    The limit ``fov_deg`` is not among them either: see :func:`refuse_limit`.
    """
    u_0, v_0 = camera.center.tolist()
    focal = getattr(camera, "focal", None)
    matrix = {"fx": getattr(camera, "fx", focal), "fy": getattr(camera, "fy", focal), "cx": u_0, "cy": v_0}
    if camera.name == "fisheye-equidistant":
        return [Intrinsics("kannala-brandt", matrix)]
    if camera.name == "fisheye-stereographic":  # the sphere model seen from its pole, where f = 2 focal
        unified = Intrinsics("unified", {**matrix, "fx": 2 * matrix["fx"], "fy": 2 * matrix["fy"], "xi": 1.0})
        return [unified, _extended(unified)]
    if camera.name not in _ARGUMENTS:
        return []
    if camera.name == "equirectangular":
        return [Intrinsics("equirectangular", {"cx": u_0, "cy": v_0})]
    if camera.name in ("scaramuzza", "ftheta"):
        return _polynomial(camera, {"cx": u_0, "cy": v_0})
    for argument, names in _ARGUMENTS[camera.name].items():
        values = np.ravel(getattr(camera, argument, 0.0)).tolist()
        matrix |= zip(names.split(), values, strict=False)
    exact = Intrinsics(camera.name, matrix)
    distorted = any(matrix.get(name) for name in ("skew", "k1", "k2", "p1", "p2"))
    return [exact, _extended(exact)] if camera.name == "unified" and not distorted else [exact]


def _polynomial(camera: Camera, center: Numbers) -> list[Intrinsics]:
    """Return the numbers of a polynomial; none where the camera has more than those."""
    (argument, names), *_ = _ARGUMENTS[camera.name].items()
    terms = getattr(camera, argument).tolist()
    plain = camera.name == "scaramuzza" or (
        camera.reference == "angle-to-pixel"  # type: ignore[attr-defined]
        and camera.linear.tolist() == [1, 0, 0]  # type: ignore[attr-defined]
        and camera.max_angle_deg is None  # type: ignore[attr-defined]
    )
    if not plain or any(terms[len(names.split()) :]):
        return []
    affine = dict(zip("cde", getattr(camera, "affine", np.zeros(0)).tolist(), strict=False))
    return [Intrinsics(camera.name, center | dict(zip(names.split(), terms, strict=False)) | affine)]


def _extended(unified: Intrinsics) -> Intrinsics:
    """Return the unified model as the extended one with ``beta`` = 1."""
    numbers = unified.numbers
    alpha = numbers["xi"] / (1 + numbers["xi"])
    scaled = {name: (1 - alpha) * numbers[name] for name in ("fx", "fy")}
    kept = {name: value for name, value in numbers.items() if name != "xi"}
    return Intrinsics("extended-unified", {**kept, **scaled, "alpha": alpha, "beta": 1.0})


def camera_of(model: str, width: int, height: int, numbers: Mapping[str, float]) -> Camera:
    """Return the camera of a model with numbers as :class:`Intrinsics` has them; those missing are 0.

    Raises:
        ArgumentError: numbers that the model refuses.
    """
    terms: dict[str, object] = {}
    for argument, names in _ARGUMENTS[model].items():
        values = [numbers.get(name, float(name == "c")) for name in names.split()]
        if any(values) or argument not in ("skew", "distortion"):
            terms[argument] = values if " " in names else values[0]
    if model == "equirectangular":
        return create(model, width, height)
    center = {"cx": numbers["cx"], "cy": numbers["cy"]}
    for name, at in center.items():
        number(
            name, at, least=-_FARTHEST_CENTER * max(width, height), most=_FARTHEST_CENTER * max(width, height)
        )
    if model == "scaramuzza":
        return create(model, width, height, center=[*center.values()], **terms)  # type: ignore[arg-type]
    if model == "ftheta":
        return create(model, width, height, **center, **terms)  # type: ignore[arg-type]
    fx, fy = numbers["fx"], numbers["fy"]
    for name in ("fx", "fy"):
        least, most = (factor * max(width, height) for factor in _FOCAL)
        number(name, numbers[name], least=least, most=most)
    if model == "division":
        if fx != fy:
            raise ArgumentError(
                "focal lengths: expected two that are equal (our division model stretches no axis), got "
                f"{fx:.15g} and {fy:.15g}"
            )
        return create(model, width, height, focal=fx, **center, **terms)  # type: ignore[arg-type]
    if model == "pinhole" and not terms and fx == fy:
        return create(model, width, height, focal=fx, center=[*center.values()])
    return create(model, width, height, fx=fx, fy=fy, **center, **terms)  # type: ignore[arg-type]


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


def held(names: Iterable[str], ours: Numbers, width: int, height: int, shift_px: float) -> Numbers | None:
    """Return a form's numbers, the inverse of :func:`complete`; None where it cannot hold ours."""
    names = list(names)
    covered = {
        word for name in names for word in (DERIVED[name].covers.split() if name in DERIVED else [name])
    }
    values: Numbers = {"cx": width / 2, "cy": height / 2}
    if any(value != values.get(name, 0.0) for name, value in ours.items() if name not in covered):
        return None
    sizes = {"W": width, "H": height, "W/2": width / 2, "H/2": height / 2}
    for name in names:
        value = DERIVED[name].write(ours, width, height) if name in DERIVED else ours.get(name, 0.0)
        if value is None:
            return None
        values[name] = sizes.get(name, value - (shift_px if name in ("cx", "cy") else 0.0))
    return values


def refuse_limit(camera: Camera) -> None:
    """Raise ArgumentError where the camera has a limit ``fov_deg``, which no format holds."""
    limit = getattr(camera, "fov_deg", None)
    if limit is not None:
        raise ArgumentError(
            f"fov_deg: expected a camera without this limit, which the format cannot carry, got "
            f"{limit:.15g}; save the same camera made without fov_deg"
        )


def parse_mapping(text: str) -> dict[str, Any]:
    """Return a YAML (or JSON) document that is a mapping; ArgumentError for anything else."""
    return mapping("file", parse_yaml(text))


def read_known(cls: type[T], value: object, where: str = "") -> T:
    """Return a record of a mapping that may have more keys: programs write more than cameras need."""
    known = {key_of(field) for field in fields(cls)}  # type: ignore[arg-type]
    return read(cls, {key: item for key, item in mapping(where, value).items() if key in known}, where)


def whole_number(name: str, value: object) -> int:
    """Return a whole number >= 1, given as such or in digits; ArgumentError for anything else."""
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        value = int(value)
    return arguments.whole_number(name, value)


@contextmanager
def only_camera(cameras: Mapping[str, T], program: str) -> Iterator[T]:
    """Yield the camera of a file that holds one; its name is in the messages of errors.

    Raises:
        ArgumentError: there are more.
    """
    if len(cameras) != 1:
        got = f"{len(cameras)}: {shown(list(cameras))}"
        raise ArgumentError(f"cameras: {program}'s file holds one camera, got {got}")
    ((name, camera),) = cameras.items()
    with within(name):
        yield camera


def check_first_is_origin(cameras: Mapping[str, RigCamera], program: str) -> None:
    """Raise ArgumentError where the first camera is not the rig's frame."""
    name, first = next(iter(cameras.items()))
    offset = max(np.abs(first.pose.position).max(), np.abs(first.pose.rotation - np.eye(3)).max())
    if offset > 1e-12:
        raise ArgumentError(
            f"{program}: expected a rig in the frame of its first camera, got another frame; save "
            f"rig.seen_from({name!r})"
        )
