"""Focal lengths and principal points: what formats give for a perspective camera and for a lens.

Numbers are ours: the principal point (cx, cy) in px with pixel centres at .5. The formats' own
half pixel is added and taken away by their readers and writers.
"""

from __future__ import annotations

from typing import NamedTuple

from omniscv.cameras import Camera
from omniscv.cameras.kannala_brandt import KannalaBrandt
from omniscv.cameras.pinhole import Pinhole
from omniscv.cameras.scaramuzza import Scaramuzza
from omniscv.errors import ArgumentError


class Intrinsics(NamedTuple):
    """Focal lengths and principal point, px."""

    fx: float
    fy: float
    cx: float
    cy: float


def perspective(width: int, height: int, given: Intrinsics) -> Camera:
    """The camera of ``u = cx + fx x / z``, ``v = cy + fy y / z``.

    A ``pinhole`` where fx = fy; else the same rays as a ``scaramuzza`` camera, which can stretch an axis:
    ``f(rho) = -fy``, affine (fx / fy, 0, 0).

    Raises:
        ArgumentError: a focal length that is not above 0.
    """
    fx, fy, cx, cy = given
    if fx <= 0 or fy <= 0:
        raise ArgumentError(f"focal lengths: expected two numbers > 0, got {fx:.15g} and {fy:.15g}")
    if fx == fy:
        return Pinhole(width, height, focal=fx, center=(cx, cy))
    return Scaramuzza(width, height, coefficients=[-fy], affine=(fx / fy, 0, 0), center=(cx, cy))


def of_perspective(camera: Camera) -> Intrinsics | None:
    """What :func:`perspective` makes the camera of; None for a camera that is not one of these."""
    cx, cy = camera.center.tolist()
    if isinstance(camera, Pinhole):
        return Intrinsics(camera.focal, camera.focal, cx, cy)
    if isinstance(camera, Scaramuzza) and camera.fov_deg is None and not camera.coefficients[1:].any():
        c, d, e = camera.affine.tolist()
        fy = -camera.coefficients[0].item()
        if c > 0 and d == e == 0:
            return Intrinsics(c * fy, fy, cx, cy)
    return None


def lens(width: int, height: int, given: Intrinsics, k: list[float]) -> KannalaBrandt:
    """The ``kannala-brandt`` camera of focal lengths, principal point and (k1, k2, k3, k4)."""
    fx, fy, cx, cy = given
    return KannalaBrandt(width, height, fx=fx, fy=fy, cx=cx, cy=cy, k=k)


def of_lens(camera: KannalaBrandt) -> tuple[Intrinsics, list[float]]:
    """What :func:`lens` makes the camera of.

    Raises:
        ArgumentError: the camera has a limit ``fov_deg``, which no format holds.
    """
    refuse_limit(camera)
    return Intrinsics(camera.fx, camera.fy, *camera.center.tolist()), camera.k.tolist()


def refuse_limit(camera: KannalaBrandt | Scaramuzza) -> None:
    """Raises ArgumentError where the camera has a limit ``fov_deg``, which no format holds."""
    if camera.fov_deg is not None:
        raise ArgumentError(
            f"fov_deg: expected a camera without this limit, which the format cannot carry, got "
            f"{camera.fov_deg:.15g}; save the same camera made without fov_deg"
        )
