"""What a server is, and what would spoil captures there: measured, not assumed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.decode import SKY
from omniscv.captures.unreal import seams
from omniscv.captures.unreal.bare_camera import EDGE_PX, FOV_DEG, BareCamera
from omniscv.captures.unreal.finding import Finding
from omniscv.captures.unreal.link import Link
from omniscv.captures.unreal.masks import colors, paint, shown
from omniscv.captures.unreal.motion import SETTLED
from omniscv.captures.unreal.probe import CLASSIC, MODERN, L
from omniscv.captures.unreal.turning import Look, contrast, fitted_fov, misfit
from omniscv.geometry import Array

_MODES = ("depth", "lit", "object_mask")
_YAWS_DEG = (0.0, 90.0, 180.0, -90.0)
_TURN_DEG = 22.5
_FORWARD_M = 0.25
_UNITS = {100.0: "cm", 1.0: "m"}
"""By how much depth shrinks when the camera moves a metre forward."""

_FOV_TOLERANCE_DEG = 1.0
_UNIT_TOLERANCE = 0.05
_POORLY = 0.3
"""A misfit above which two pictures cannot be brought together."""
_CLEARLY = 3.0
"""How many times better the true meaning of depth must fit than the other."""
_COARSE_MM = 10.0

Looks = dict[str, list[tuple[Look, Look]]]
"""By mode, pictures before and after a turn, in several directions."""


def examine(link: Link, position: Array | None = None) -> list[Finding]:
    """Examines a server; takes some hundred pictures.

    Mask colours are made distinct first, as for a recording.

    Args:
        link: the way to it.
        position: (3,) where to look around, world frame, metres; None: where the player is.

    Raises:
        SourceError: the connection breaks, or the server cannot make pictures.
    """
    paint(link)
    with BareCamera(link, position) as camera:
        settled = settle(camera)
        looks = _looks(camera)
        kind, meaning = depth_kind(looks, camera)
        unit, scale = depth_unit(camera)
        return [
            dialect(link, camera),
            settled,
            capabilities(camera, looks),
            sizes(looks),
            *(field_of_view(mode, looks, camera, kind) for mode in _MODES),
            meaning,
            scale,
            half_floats(looks, unit),
            masks(link, looks),
            *seams.findings(seams.measure(camera)),
        ]


def dialect(link: Link, camera: BareCamera) -> Finding:
    """What the server speaks, and what it says it is."""
    version, scene = (link.text(f"vget /{what}") for what in ("unrealcv/version", "scene/name"))
    return Finding("dialect", f"{camera.dialect}; calls itself {version}, scene {scene}")


def settle(camera: BareCamera) -> Finding:
    """How long pictures show the old pose after a turn. From now on the camera waits so long."""
    turns = [camera.settle(yaw, pitch) for yaw, pitch in ((0, 0), (100, 20), (-130, -30), (45, 10))]
    known = [turn for turn in turns if turn is not None]
    if len(known) < len(turns):
        return Finding("pose settles", "never: the world moves", "bad", "pause the game, stop animations")
    camera.lag = late = max(pictures for pictures, _ in known[1:])
    seconds = float(np.median([took for _, took in known[1:]]))
    value = f"after {late} late pictures, {1000 * seconds:.0f} ms"
    if late == 0:
        return Finding("pose settles", f"at once, first picture after {1000 * seconds:.0f} ms")
    if late <= SETTLED:
        return Finding("pose settles", value, "warning", "none needed: recordings skip them, and take longer")
    return Finding("pose settles", value, "bad", f"at most {SETTLED} are skipped: raise the frame rate")


def capabilities(camera: BareCamera, looks: Looks) -> Finding:
    """Whether size and field of view obey, and straight up is straight up."""
    height, width = looks["lit"][0][0].pixels.shape[:2]
    camera.go(0, 90)
    pitch = camera.rotation()[0]
    can = {
        "sets size": (width, height) == (EDGE_PX, EDGE_PX),
        "sets field of view": abs(camera.fov_deg - FOV_DEG) < 1e-3,
        "looks straight up": abs(pitch - 90) < 1e-3,
    }
    value = ", ".join(("" if does else "not: ") + what for what, does in can.items())
    if all(can.values()):
        return Finding("capabilities", value)
    return Finding(
        "capabilities", value, "warning", "Width = Height and FOV 90 in unrealcv.ini serve as well"
    )


def sizes(looks: Looks) -> Finding:
    """Whether the modes' pictures have one size."""
    found = {mode: looks[mode][0][0].pixels.shape[1::-1] for mode in _MODES}
    if len(set(found.values())) == 1:
        return Finding("picture size", "{} x {} px in all modes".format(*found["lit"]))
    value = ", ".join(f"{mode} {width} x {height}" for mode, (width, height) in found.items())
    return Finding("picture size", value, "bad", "start the game in a window of its Width x Height")


def field_of_view(mode: str, looks: Looks, camera: BareCamera, kind: str) -> Finding:
    """The field of view that a mode really has."""
    name = f"field of view, {mode}"
    fov, left = fitted_fov(*_clearest(looks[mode]), kind if mode == "depth" else "")
    if left > _POORLY:
        return Finding(name, "nothing to tell by", "warning", "give --position where there is more to see")
    value = f"{fov:.1f} degrees, {camera.fov_deg:.1f} said"
    if abs(fov - camera.fov_deg) < _FOV_TOLERANCE_DEG:
        return Finding(name, value)
    return Finding(name, value, "bad", "set FOV in unrealcv.ini, and no CameraActor in the level")


def depth_kind(looks: Looks, camera: BareCamera) -> tuple[str, Finding]:
    """Planar or along the ray: what stays the same when the camera turns."""
    pair = _clearest(looks["depth"])
    planar, ray = (misfit(*pair, camera.fov_deg, kind) for kind in ("planar", "ray"))
    kind, times = ("planar", ray / planar) if planar < ray else ("ray", planar / ray)
    wanted = (CLASSIC if camera.dialect == L else MODERN).depth_kind
    value = f"{kind}; the other fits {times:.0f} times worse"
    if times < _CLEARLY:
        return wanted, Finding("depth is", "hard to tell", "warning", "give --position with things at hand")
    return kind, _as_expected("depth is", value, kind, wanted)


def depth_unit(camera: BareCamera) -> tuple[str, Finding]:
    """By how much depth straight ahead shrinks when the camera moves there."""
    wanted = (CLASSIC if camera.dialect == L else MODERN).depth_unit
    shrinks = []
    for yaw, pitch in seams.FACES.values():
        ahead = []
        for forward_m in (0.0, _FORWARD_M):
            camera.go(yaw, pitch, forward_m)
            depth = camera.pixels("depth")
            ahead.append(float(depth[depth.shape[0] // 2, depth.shape[1] // 2]))
        if ahead[1] < ahead[0] < SKY:
            shrinks.append((ahead[0] - ahead[1]) / _FORWARD_M)
    measured = float(np.median(shrinks)) if shrinks else 0.0
    for per_m, unit in _UNITS.items():
        if abs(measured / per_m - 1) < _UNIT_TOLERANCE:
            value = f"{unit}; {measured:.4g} less for each metre forward"
            return unit, _as_expected("depth unit", value, unit, wanted)
    value = f"neither cm nor m: {measured:.4g} less for each metre forward"
    return wanted, Finding("depth unit", value, "bad", "give --position with walls around")


def half_floats(looks: Looks, unit: str) -> Finding:
    """How coarse depth is."""
    depth = np.concatenate([look.pixels.ravel() for pair in looks["depth"] for look in pair])
    depth = depth[depth < SKY]
    if depth.size == 0:
        return Finding(
            "depth steps", "nothing but sky", "warning", "give --position where there is more to see"
        )
    middle = float(np.median(depth))
    halves = depth.astype(np.float16)
    dtype = np.float16 if (halves == depth).all() else np.float32
    to_m = 0.01 if unit == "cm" else 1.0
    step_mm = 1000 * to_m * float(np.spacing(dtype(middle)))
    value = f"{np.dtype(dtype).name}: {step_mm:.2g} mm at {middle * to_m:.2f} m"
    if step_mm > _COARSE_MM:
        return Finding("depth steps", value, "warning", "none: terraces are the engine's; stay nearer")
    return Finding("depth steps", value)


def masks(link: Link, looks: Looks) -> Finding:
    """Whether every colour in a mask belongs to one object."""
    set_colors = colors(link)
    seen: set[tuple[int, ...]] = set()
    for pair in looks["object_mask"]:
        for look in pair:
            seen |= {tuple(color) for color in np.unique(look.pixels.reshape(-1, 3), axis=0).tolist()}
    seen.discard((0, 0, 0))
    bent = bool(seen - set(set_colors.values()))
    displayed = {name: shown(color) if bent else color for name, color in set_colors.items()}
    by_color: dict[tuple[int, ...], list[str]] = {(0, 0, 0): ["the background"]}
    for name, color in displayed.items():
        by_color.setdefault(color, []).append(name)
    alike = [" = ".join(names) for names in by_color.values() if len(names) > 1]
    strange = seen - set(displayed.values())
    value = f"{len(set_colors)} objects, {len(seen)} colours seen" + (", bent by gamma" if bent else "")
    if alike:
        value += f"; alike: {'; '.join(alike)}"
        return Finding("mask colours", value, "bad", "vset /object/NAME/color R G B, each 0 or 135 to 231")
    if strange:
        value += f"; {len(strange)} of no object, such as {min(strange)}"
        return Finding("mask colours", value, "bad", "no antialiasing, lit or emissive things in masks")
    return Finding("mask colours", value)


def _as_expected(name: str, value: str, found: str, wanted: str) -> Finding:
    if found == wanted:
        return Finding(name, value)
    return Finding(name, value, "bad", f"recordings take it as {wanted}: report this server, do not record")


def _looks(camera: BareCamera) -> Looks:
    """Pictures in every mode, before and after a turn."""

    def all_modes(yaw_deg: float) -> dict[str, Look]:
        pose = camera.go(yaw_deg)
        pixels: dict[str, NDArray[Any]] = {mode: camera.pixels(mode) for mode in _MODES}
        return {mode: Look(pixels[mode], pose) for mode in _MODES}

    turns = [(all_modes(yaw), all_modes(yaw + _TURN_DEG)) for yaw in _YAWS_DEG]
    return {mode: [(before[mode], after[mode]) for before, after in turns] for mode in _MODES}


def _clearest(pairs: list[tuple[Look, Look]]) -> tuple[Look, Look]:
    """The direction in which there is most to see."""
    return max(pairs, key=lambda pair: contrast(pair[0]))
