"""What a server is, and what would spoil captures there: measured, not assumed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.decode import SKY
from omniscv.captures.unreal import seams
from omniscv.captures.unreal.bare_camera import EDGE_PX, BareCamera, across, alike
from omniscv.captures.unreal.finding import Finding
from omniscv.captures.unreal.link import Link
from omniscv.captures.unreal.masks import Color, colors, paint, shown
from omniscv.captures.unreal.motion import SETTLED
from omniscv.captures.unreal.probe import CLASSIC, MODERN, L
from omniscv.captures.unreal.turning import Look, fitted_fov, misfit
from omniscv.geometry import Array

_MODES = ("depth", "lit", "object_mask")
_YAWS_DEG = (0.0, 90.0, 180.0, -90.0)
_TURN_DEG = 22.5
_FORWARD_M = 0.25
_UNITS = {100.0: "cm", 1.0: "m"}
"""By how much depth shrinks when the camera moves a metre forward."""

_PRINTED = 1e-3
"""Servers print three decimals."""
_FOV_TOLERANCE_DEG = 1.0
_UNIT_TOLERANCE = 0.05
_POORLY = 0.3
"""A misfit above which two pictures cannot be brought together."""
_EXACT = 1e-6
"""A misfit that rounding may leave."""
_CLEARLY = 3.0
"""How many times better the true meaning of depth must fit than the other."""
_COARSE_MM = 10.0
_DARK: Color = (120, 35, 63)
"""A mask colour that plugin 0.3.10 shows as another, in every channel."""

_ELSEWHERE = "give --position where there is more to see"
_WINDOW = "a square window, Width = Height, FOV 90 in unrealcv.ini"
_UNKNOWN = "do not record: this server is of no known kind"

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
    mode = view_mode(link)
    with BareCamera(link, position) as camera:
        paint(link, exact=camera.dialect == L)
        settled = settle(camera)
        looks = look_around(camera)
        kind, meaning = depth_kind(looks, camera)
        unit, scale = depth_unit(camera)
        return [
            dialect(link, camera),
            mode,
            settled,
            capabilities(camera),
            sizes(looks, camera),
            *(field_of_view(mode, looks, camera, kind) for mode in _MODES),
            meaning,
            scale,
            half_floats(looks, unit),
            masks(link, camera, looks),
            *seams.findings(seams.measure(camera)),
        ]


def dialect(link: Link, camera: BareCamera) -> Finding:
    """What the server speaks, and what it says it is."""
    version, scene = (link.text(f"vget /{what}") for what in ("unrealcv/version", "scene/name"))
    return Finding("dialect", f"{camera.dialect}; calls itself {version}, scene {scene}")


def view_mode(link: Link) -> Finding:
    """What the game's window shows: depth and normals there get into colour captures too."""
    mode = link.text("vget /viewmode")
    if mode == "lit":
        return Finding("view mode", mode)
    return Finding("view mode", mode, "bad", "vset /viewmode lit")


def settle(camera: BareCamera) -> Finding:
    """How long pictures show the old pose after a turn. From now on the camera waits so long."""
    turns = [camera.settle(yaw, pitch) for yaw, pitch in ((0, 0), (100, 20), (-130, -30), (45, 10))]
    if not all(turn.rests for turn in turns):
        return Finding("pose settles", "never: the world moves", "bad", "pause the game, stop animations")
    first, *later = turns  # the first pictures of a camera may be garbage
    if (first.depth < SKY).any() and all(alike(turn.depth, first.depth) for turn in later):
        return Finding("pose settles", "never: the camera does not turn", "bad", "vset /action/game/resume")
    camera.lag = late = max(turn.late for turn in later)
    milliseconds = 1000 * float(np.median([turn.seconds for turn in later]))
    if late == 0:
        return Finding("pose settles", f"at once, first picture after {milliseconds:.0f} ms")
    value = f"late pictures: {late}, {milliseconds:.0f} ms"
    if late <= SETTLED:
        return Finding("pose settles", value, "warning", "none needed: recordings skip them")
    return Finding("pose settles", value, "bad", f"at most {SETTLED} are skipped: raise the frame rate")


def capabilities(camera: BareCamera) -> Finding:
    """Whether size and field of view obey, and straight up is straight up."""
    camera.go(0, 90)
    can = {
        "sets size": camera.dialect != L and camera.size == (EDGE_PX, EDGE_PX),
        "sets field of view": abs(camera.fov_deg - across(*camera.size)) < _PRINTED,
        "looks straight up": abs(camera.rotation()[0] - 90) < _PRINTED,
    }
    value = ", ".join(("" if does else "not: ") + what for what, does in can.items())
    if all(can.values()):
        return Finding("capabilities", value)
    return Finding("capabilities", value, "warning", "none needed: recordings allow for it")


def sizes(looks: Looks, camera: BareCamera) -> Finding:
    """Whether the modes' pictures have one size."""
    found = {mode: looks[mode][0][0].pixels.shape[1::-1] for mode in _MODES}
    if len(set(found.values())) == 1:
        return Finding("picture size", "{} x {} px in all modes".format(*found["lit"]))
    value = ", ".join(f"{mode} {width} x {height}" for mode, (width, height) in found.items())
    return Finding("picture size", value, "warning" if camera.dialect == L else "bad", _WINDOW)


def field_of_view(mode: str, looks: Looks, camera: BareCamera, kind: str) -> Finding:
    """The field of view that a mode really has, and whether six of its pictures make a cube."""
    name = f"field of view, {mode.removeprefix('object_')}"
    fits = [fitted_fov(*pair, kind if mode == "depth" else "") for pair in looks[mode]]
    clear = [fov for fov, left in fits if left < _POORLY]
    if not clear:
        return Finding(name, "nothing to tell by", "warning", _ELSEWHERE)
    fov, said = float(np.median(clear)), camera.mask_fov_deg if mode == "object_mask" else camera.fov_deg
    value = f"{fov:.1f} degrees, {said:.1f} said"
    if abs(fov - said) > _FOV_TOLERANCE_DEG:
        return Finding(name, value, "bad", "FOV 90 in unrealcv.ini, no CameraActor in the level")
    height, width = looks[mode][0][0].pixels.shape[:2]
    if said < across(width, height) - _PRINTED:
        return Finding(name, f"{value}: less than 90 up and down", "bad", _WINDOW)
    return Finding(name, value)


def depth_kind(looks: Looks, camera: BareCamera) -> tuple[str, Finding]:
    """Planar or along the ray: what stays the same when the camera turns."""
    planar, ray = (
        max(_EXACT, float(np.mean([misfit(*pair, camera.fov_deg, kind) for pair in looks["depth"]])))
        for kind in ("planar", "ray")
    )
    kind, times = ("planar", ray / planar) if planar < ray else ("ray", planar / ray)
    wanted = (CLASSIC if camera.dialect == L else MODERN).depth_kind
    value = f"{kind}; the other fits {times:.0f} times worse"
    if times < _CLEARLY:
        return wanted, Finding("depth is", "hard to tell", "warning", _ELSEWHERE)
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
    if not shrinks:
        return wanted, Finding("depth unit", "nothing but sky", "warning", _ELSEWHERE)
    measured = float(np.median(shrinks))
    for per_m, unit in _UNITS.items():
        if abs(measured / per_m - 1) < _UNIT_TOLERANCE:
            value = f"{unit}; {measured:.4g} less for each metre forward"
            return unit, _as_expected("depth unit", value, unit, wanted)
    value = f"neither cm nor m: {measured:.4g} less for each metre forward"
    return wanted, Finding("depth unit", value, "bad", _UNKNOWN)


def half_floats(looks: Looks, unit: str) -> Finding:
    """How coarse depth is."""
    depth = np.concatenate([look.pixels.ravel() for pair in looks["depth"] for look in pair])
    depth = depth[depth < SKY]
    if depth.size == 0:
        return Finding("depth steps", "nothing but sky", "warning", _ELSEWHERE)
    middle = float(np.median(depth))
    halves = depth.astype(np.float16)
    dtype = np.float16 if (halves == depth).all() else np.float32
    to_m = 0.01 if unit == "cm" else 1.0
    step_mm = 1000 * to_m * float(np.spacing(dtype(middle)))
    value = f"{np.dtype(dtype).name}: {step_mm:.2g} mm at {middle * to_m:.2f} m"
    if step_mm > _COARSE_MM:
        return Finding("depth steps", value, "warning", "none: terraces are the engine's; stay nearer")
    return Finding("depth steps", value)


def masks(link: Link, camera: BareCamera, looks: Looks) -> Finding:
    """Whether every colour in a mask belongs to one object."""
    table = colors(link)
    seen = {color for pair in looks["object_mask"] for look in pair for color in _areas(look.pixels)}
    bends = _bends(link, camera, table)
    displayed = {name: shown(color) if bends else color for name, color in table.items()}
    by_color: dict[Color, list[str]] = {(0, 0, 0): ["background"]}
    for name, color in displayed.items():
        by_color.setdefault(color, []).append(name)
    alike = [" = ".join(names) for names in by_color.values() if len(names) > 1]
    strange = seen - set(by_color)
    value = f"{len(table)} objects, {len(seen)} colours seen" + (", dark ones bent" if bends else "")
    if alike:
        cure = "vset /object/NAME/color R G B, each 0 or 146 to 255"
        return Finding("mask colours", f"{value}; alike: {'; '.join(alike)}", "bad", cure)
    if strange:
        value += f"; {len(strange)} of no object, such as {min(strange)}"
        return Finding("mask colours", value, "bad", "turn antialiasing off; paint what has no colour")
    return Finding("mask colours", value)


def _bends(link: Link, camera: BareCamera, table: dict[str, Color]) -> bool:
    """Whether the mask shows dark colours as others than they were set: tried on what is largest in sight."""
    names = {color: name for name, color in table.items()}
    camera.go(_YAWS_DEG[0])
    areas = {names[c]: n for c, n in _areas(camera.pixels("object_mask")).items() if c in names}
    if not areas:
        return False
    name = max(areas, key=areas.__getitem__)
    _paint(link, name, _DARK)
    bends = shown(_DARK) in _areas(camera.pixels("object_mask"))
    _paint(link, name, table[name])
    return bends


def _paint(link: Link, name: str, color: Color) -> None:
    link.text("vset /object/{}/color {} {} {}".format(name, *color))


def _areas(pixels: NDArray[np.uint8]) -> dict[Color, int]:
    """How many pixels have each colour."""
    codes, counts = np.unique(pixels.astype(np.int32) @ (1 << 16, 1 << 8, 1), return_counts=True)
    colors_seen = [(code >> 16, code >> 8 & 255, code & 255) for code in codes.tolist()]
    return dict(zip(colors_seen, counts.tolist(), strict=True))


def _as_expected(name: str, value: str, found: str, wanted: str) -> Finding:
    if found == wanted:
        return Finding(name, value)
    return Finding(name, f"{value}; recordings take it as {wanted}", "bad", _UNKNOWN)


def look_around(camera: BareCamera) -> Looks:
    """Pictures in every mode, before and after a turn."""

    def all_modes(yaw_deg: float) -> dict[str, Look]:
        pose = camera.go(yaw_deg)
        pixels: dict[str, NDArray[Any]] = {mode: camera.pixels(mode) for mode in _MODES}
        return {mode: Look(pixels[mode], pose) for mode in _MODES}

    turns = [(all_modes(yaw), all_modes(yaw + _TURN_DEG)) for yaw in _YAWS_DEG]
    return {mode: [(before[mode], after[mode]) for before, after in turns] for mode in _MODES}
