"""What the formats share: values out of untrusted text, and intrinsics."""

from collections.abc import Iterable, Mapping
from typing import Any

from omniscv import arguments, yaml_text
from omniscv.arguments import shown
from omniscv.cameras import Camera, KannalaBrandt, Pinhole, Scaramuzza
from omniscv.errors import ArgumentError

HALF_PIXEL = 0.5
"""Added to a principal point of a format that puts pixel centres at whole numbers; ours are at .5."""


def mapping(text: str) -> dict[str, Any]:
    """Return the mapping that a YAML (or JSON) document is; raise ArgumentError for all else."""
    data = yaml_text.parse(text)
    if not isinstance(data, dict):
        raise ArgumentError(f"expected a YAML mapping, got {shown(data)}")
    return data


def field(data: object, key: str) -> Any:
    """Return ``data[key]``; raise ArgumentError where ``data`` is no mapping, or has no such key."""
    if not isinstance(data, dict):
        raise ArgumentError(f"expected a mapping with {key!r} in it, got {shown(data)}")
    if key not in data:
        raise ArgumentError(f"expected the key {key!r}, got {shown(list(data))}")
    return data[key]


def whole_number(key: str, value: object) -> int:
    """Return a whole number >= 1, given as such or in digits; raise ArgumentError for all else."""
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        value = int(value)
    return arguments.whole_number(key, value)


def only_camera(cameras: Mapping[str, Camera], program: str) -> tuple[str, Camera]:
    """Return the name and the camera of a file that holds one; raise ArgumentError if there are more."""
    if len(cameras) != 1:
        raise ArgumentError(
            f"cameras: {program}'s file holds one camera, got {len(cameras)}: {shown(list(cameras))}"
        )
    return next(iter(cameras.items()))


def camera_of(width: int, height: int, intrinsics: Iterable[float], shift_px: float = 0.0) -> Camera:
    """Return the camera of (fx, fy, cx, cy), or of (fx, fy, cx, cy, k1, k2, k3, k4), ``shift_px`` added to
    the principal point.

    Eight numbers are a ``kannala-brandt`` lens. Four are ``u = cx + fx x / z``, ``v = cy + fy y / z``: a
    ``pinhole`` where fx = fy; else the same rays as a ``scaramuzza`` camera, which can stretch an axis:
    ``f(rho) = -fy``, affine (fx / fy, 0, 0).

    Raises:
        ArgumentError: a focal length that is not above 0.
    """
    fx, fy, cx, cy, *k = intrinsics
    center = (cx + shift_px, cy + shift_px)
    if k:
        return KannalaBrandt(width, height, fx, fy, *center, k=k)
    if fx <= 0 or fy <= 0:
        raise ArgumentError(f"focal lengths: expected two numbers > 0, got {fx:.15g} and {fy:.15g}")
    if fx == fy:
        return Pinhole(width, height, focal=fx, center=center)
    return Scaramuzza(width, height, coefficients=[-fy], affine=(fx / fy, 0, 0), center=center)


def intrinsics_of(camera: Camera, shift_px: float = 0.0) -> list[float] | None:
    """Return what :func:`camera_of` makes the camera of; None for a camera of another kind.

    Raises:
        ArgumentError: a lens with a limit ``fov_deg``, which no format holds.
    """
    cx, cy = (camera.center - shift_px).tolist()
    if isinstance(camera, KannalaBrandt):
        refuse_limit(camera)
        return [camera.fx, camera.fy, cx, cy, *camera.k.tolist()]
    if isinstance(camera, Pinhole):
        return [camera.focal, camera.focal, cx, cy]
    if isinstance(camera, Scaramuzza) and camera.fov_deg is None and not camera.coefficients[1:].any():
        c, d, e = camera.affine.tolist()
        fy = -camera.coefficients[0].item()
        if c > 0 and d == e == 0:
            return [c * fy, fy, cx, cy]
    return None


def refuse_limit(camera: KannalaBrandt | Scaramuzza) -> None:
    """Raise ArgumentError where the camera has a limit ``fov_deg``, which no format holds."""
    if camera.fov_deg is not None:
        raise ArgumentError(
            f"fov_deg: expected a camera without this limit, which the format cannot carry, got "
            f"{camera.fov_deg:.15g}; save the same camera made without fov_deg"
        )
