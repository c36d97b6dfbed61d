"""Cameras as named numbers, as calibration files hold them.

A format is a table of its models, and of the numbers that it holds of each: :func:`format_models`.
What the formats share is here too: values from untrusted text, and the one camera of a file.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import numpy as np

from omniscv import arguments
from omniscv.arguments import Reader, shown, within
from omniscv.cameras import Camera, create
from omniscv.cameras.rig import Rig
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
}
"""By model: the constructor arguments beyond size, focal lengths and centre, and the numbers of each."""

MODELS = tuple(_ARGUMENTS)
"""The models that such numbers describe."""

Numbers = dict[str, float]

T = TypeVar("T")


class Intrinsics(NamedTuple):
    """A model's name, and its numbers: fx, fy, cx, cy (px, our pixel rule) and those of ``_ARGUMENTS``."""

    model: str
    numbers: Numbers


class FormatModel(NamedTuple):
    """A model as a format has it.

    Attributes:
        name: in the format.
        model: ours.
        numbers: their names in the format's order; ``f`` is fx = fy. Missing ones are 0.
    """

    name: str
    model: str
    numbers: tuple[str, ...]


def format_models(table: str) -> dict[str, FormatModel]:
    """Return the models of a format by name: each line has the name, our model, and the numbers in order."""
    rows = [line.split() for line in table.strip().splitlines()]
    return {name: FormatModel(name, model, tuple(numbers)) for name, model, *numbers in rows}


def intrinsics(camera: Camera) -> list[Intrinsics]:
    """Return the models that have a camera's rays, and their numbers; its own model comes first.

    The image circle of lenses such as ``fisheye-equidistant`` is not among these numbers.

    Raises:
        ArgumentError: a camera with a limit ``fov_deg``, which no format holds.
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
    refuse_limit(camera)
    for argument, names in _ARGUMENTS[camera.name].items():
        values = np.ravel(getattr(camera, argument, 0.0)).tolist()
        matrix |= zip(names.split(), values, strict=False)
    exact = Intrinsics(camera.name, matrix)
    distorted = any(matrix.get(name) for name in ("skew", "k1", "k2", "p1", "p2"))
    return [exact, _extended(exact)] if camera.name == "unified" and not distorted else [exact]


def _extended(unified: Intrinsics) -> Intrinsics:
    """Return the unified model as the extended one with ``beta`` = 1."""
    numbers = unified.numbers
    alpha = numbers["xi"] / (1 + numbers["xi"])
    scaled = {name: (1 - alpha) * numbers[name] for name in ("fx", "fy")}
    return Intrinsics("extended-unified", {**numbers, **scaled, "alpha": alpha, "beta": 1.0})


def camera_of(model: str, width: int, height: int, numbers: Mapping[str, float]) -> Camera:
    """Return the camera of a model with numbers as :class:`Intrinsics` has them; those missing are 0.

    Raises:
        ArgumentError: numbers that the model refuses.
    """
    terms: dict[str, object] = {}
    for argument, names in _ARGUMENTS[model].items():
        values = [numbers.get(name, 0.0) for name in names.split()]
        if any(values) or argument not in ("skew", "distortion"):
            terms[argument] = values if " " in names else values[0]
    center = {"cx": numbers["cx"], "cy": numbers["cy"]}
    fx, fy = numbers["fx"], numbers["fy"]
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


def read_numbers(row: FormatModel, values: Iterable[float], shift_px: float) -> Numbers:
    """Return the numbers of a format's model by name; ``shift_px`` is added to the principal point."""
    numbers = dict(zip(row.numbers, values, strict=True))
    if "f" in numbers:
        numbers["fx"] = numbers["fy"] = numbers.pop("f")
    numbers["cx"], numbers["cy"] = numbers["cx"] + shift_px, numbers["cy"] + shift_px
    return numbers


def write_numbers(
    camera: Camera, rows: Iterable[FormatModel], shift_px: float, expected: str
) -> tuple[FormatModel, list[float]]:
    """Return the first of a format's models that holds all numbers of a camera, and these in its order.

    Args:
        camera: to be written.
        rows: the models of the format, those of fewest numbers first.
        shift_px: subtracted from the principal point.
        expected: the start of the error's message, such as ``Aria: expected kannala-brandt``.

    Raises:
        ArgumentError: the format has no such model, or a camera with a limit ``fov_deg``.
    """
    rows = list(rows)
    for model, numbers in intrinsics(camera):
        for row in rows:
            if row.model == model and (values := _in_order(row, numbers, shift_px)) is not None:
                return row, values
    raise ArgumentError(f"{expected}, got {camera.name}")


def _in_order(row: FormatModel, numbers: Numbers, shift_px: float) -> list[float] | None:
    shifted = {**numbers, "cx": numbers["cx"] - shift_px, "cy": numbers["cy"] - shift_px}
    if "f" in row.numbers:
        if shifted.pop("fx") != shifted["fy"]:
            return None
        shifted["f"] = shifted.pop("fy")
    needed = {"fx", "fy", "cx", "cy", *" ".join(_ARGUMENTS[row.model].values()).split()}
    if any(value for name, value in shifted.items() if name in needed and name not in row.numbers):
        return None
    return [shifted.get(name, 0.0) for name in row.numbers]


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


def known(cls: type[Any]) -> Reader:
    """Return a reader of a record inside another: see :func:`read_known`."""
    return lambda name, value: value if isinstance(value, cls) else read_known(cls, value, name)


def whole_number(name: str, value: object) -> int:
    """Return a whole number >= 1, given as such or in digits; ArgumentError for anything else."""
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        value = int(value)
    return arguments.whole_number(name, value)


def image_size(name: str, value: object) -> tuple[int, int]:
    """Return (width, height), a list of two whole numbers; ArgumentError for anything else."""
    if not isinstance(value, list) or len(value) != 2:
        raise ArgumentError(f"{name}: expected [width, height], got {shown(value)}")
    width, height = (whole_number(f"{name}[{i}]", size) for i, size in enumerate(value))
    return width, height


@contextmanager
def only_camera(cameras: Mapping[str, Camera], program: str) -> Iterator[Camera]:
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


def check_first_is_origin(rig: Rig, program: str) -> None:
    """Raise ArgumentError where the first camera is not the rig's frame."""
    name, first = next(iter(rig.cameras.items()))
    offset = max(np.abs(first.pose.position).max(), np.abs(first.pose.rotation - np.eye(3)).max())
    if offset > 1e-12:
        raise ArgumentError(
            f"{program}: expected a rig in the frame of its first camera, got another frame; save "
            f"rig.seen_from({name!r})"
        )
