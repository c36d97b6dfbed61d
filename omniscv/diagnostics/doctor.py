"""The doctor: measures a server through the camera drivers, and reports findings."""

from collections.abc import Iterator, Mapping
from itertools import chain, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Unpack

import numpy as np

from omniscv import storage
from omniscv.arguments import shown
from omniscv.diagnostics import Finding, agreement
from omniscv.diagnostics.blender_scene import examine_blender
from omniscv.diagnostics.posed_pictures import examine_folder
from omniscv.diagnostics.recorded_faces import examine_recording
from omniscv.diagnostics.self_calibration import Picture, fitted_fov, misfit
from omniscv.diagnostics.server import (
    EDGE_PX,
    FACES,
    NEVER,
    MovingWorld,
    RawCamera,
    across,
    alike,
    color_counts,
    largest_object,
)
from omniscv.errors import ArgumentError, ServerRefusedError
from omniscv.geometry import Array, Pose
from omniscv.importing.folders import INDEX, import_folder
from omniscv.sources.base import Color
from omniscv.sources.codecs import UNREAL_SKY, show_light
from omniscv.sources.registry import Deadlines, open_source, scheme_of
from omniscv.sources.unreal import open_connection, protocol
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.driver import SETTLED, matching_bias
from omniscv.sources.unreal.objects import boxes, colors, paint_command, vertex_color_roundtrip
from omniscv.sources.unreal.protocol import DIALECTS, EXPOSURE_METHOD, LEGACY, LIT_VIEW_MODE, SCENE, VERSION

_MODES = ("depth", "lit", "object_mask")
_YAWS_DEG = (0.0, 90.0, 180.0, -90.0)
_TURN_DEG = 22.5
_FORWARD_M = 0.25
_UNITS = {100.0: "cm", 1.0: "m"}  # by how much depth decreases when the camera moves a metre forward
_PRINTED = 1e-3  # servers print three decimals
_DARK: Color = (120, 35, 63)  # a mask colour of which plugin 0.3.10 changes every channel
# How long colours change after a turn:
_WARM = 24  # frames that are watched
_MOST = 0.99  # share of the pixels that must have settled
_BACK_DEG = 150  # the turn
_WINDOW = "a square window, Width = Height, FOV 90 in unrealcv.ini"
_UNKNOWN = "do not record: this server is of no known kind"

Pairs = dict[str, list[tuple[Picture, Picture]]]
"""By mode, pictures before and after a turn, in several directions."""


def examine_address(
    address: str,
    position: Array | None = None,
    quick: bool = False,
    *,
    picture: Path | None = None,
    layout: str = "auto",
    said: Mapping[str, Any] | None = None,
    **deadlines: Unpack[Deadlines],
) -> list[Finding]:
    """Examine a server by some hundred pictures; mask colours are made distinct first, as for a recording.

    Args:
        address: ``unreal://host:port``, ``unreal+unix:///path`` or ``mock://scene``; or what another
            module examines: ``blender://SCENE.blend``, ``mesh://ROOM.glb``, a recording, a folder of its
            captures, or frames with poses.
        position: (3,) where to measure, world frame, metres; None: the player's position.
        quick: leave out the unit of depth, what captures say of each other, and what moves.
        picture: PNG to write, of a recording's worst edge.
        layout: of a folder of frames, as of an import.
        said: further options of the import of such a folder.
        deadlines: ``timeout_s`` and ``patience_s``, as for :func:`omniscv.open_source`.

    Raises:
        ArgumentError: an address of another form, or options that are of others.
        SourceError: no UnrealCV server reachable there, or one that makes no pictures.
    """
    is_file = scheme_of(address) in (None, *storage.SCHEMES)
    path = Path(address)
    is_frames = is_file and path.is_dir() and not (path / INDEX).exists()
    if (layout != "auto" or said) and not is_frames:
        raise ArgumentError(f"layout: expected a folder of frames with poses, got {shown(address)}")
    if picture is not None and (is_frames or not is_file):
        raise ArgumentError(f"picture: expected a recording or a folder of captures, got {shown(address)}")
    if is_frames:
        return examine_folder(path, layout, **(said or {}))
    if is_file:
        return _examine_captures(address, picture)
    if scheme_of(address) == "blender":
        return examine_blender(address, position, **deadlines)
    if scheme_of(address) == "mesh":
        from omniscv.diagnostics.mesh import examine_mesh

        return examine_mesh(address, position)
    with open_connection(address, **deadlines) as connection:
        return _examine_server(connection, position, quick)


def _examine_captures(address: str, picture: Path | None) -> list[Finding]:
    """Examine a recording, or a folder of captures."""
    with TemporaryDirectory() as temporary:
        if Path(address).is_dir():
            recording = f"{temporary}/captures.sqlite"
            import_folder(Path(address), Path(recording))
            address = recording
        with open_source(address) as source:  # says what to write in place of host:port
            return examine_recording(source, picture)


def _examine_server(connection: Connection, position: Array | None, quick: bool) -> list[Finding]:
    """Examine a server, whose world is paused if it moves."""
    mode = view_mode(connection)
    with RawCamera(connection, position) as camera:
        world = MovingWorld(connection, camera)
        motion = [] if quick else world.findings()
        with world.still():
            return [*_findings(connection, camera, mode, quick), *motion]


def _findings(connection: Connection, camera: RawCamera, mode: Finding, quick: bool) -> Iterator[Finding]:
    """Yield what a server is, while its world stands still."""
    settled = settle(camera)
    pairs = turned_pairs(camera)
    kind, meaning = depth_kind(pairs, camera)
    # Depth says what the field of view is only if it is known which depth it is.
    aligned = _MODES[1:] if meaning.verdict == "warning" else _MODES
    version, scene = map(protocol.name, connection.texts([VERSION, SCENE]))
    dialect = connection.plugin.dialect
    plugin = DIALECTS[dialect]
    value = f"{dialect}: {plugin.plugin}; {plugin.engine}; reports version {version}, scene {scene}"
    yield Finding("dialect", value)
    yield mode
    yield settled
    if not quick:
        yield warm_up(camera)
    yield capabilities(camera)
    yield from right_eye(connection, camera)
    yield normals(camera)
    yield sizes(pairs, camera)
    for aligned_mode in aligned:
        yield field_of_view(aligned_mode, pairs, camera, kind)
    yield meaning
    unit = camera.driver.table.depth[1]
    if not quick:
        unit, scale = depth_unit(camera)
        yield scale
    yield half_floats(pairs, unit)
    yield masks(connection, camera, pairs)
    if not quick:
        table = colors(connection)
        yield from agreement.findings(camera, table, boxes(connection, list(table)))
        yield from manual_exposure(connection, camera)


def view_mode(connection: Connection) -> Finding:
    """Report what the game's window shows: depth and normals there spoil colour captures."""
    mode = protocol.name(connection.text("vget /viewmode"))
    return Finding.unless(mode == "lit", "view mode", mode, "bad", LIT_VIEW_MODE)


def settle(camera: RawCamera) -> Finding:
    """Measure how long frames stay stale after a turn, and set the camera's ``lag``."""
    counts = []
    seconds = []
    depths = []
    for yaw_deg, pitch_deg in ((0, 0), (100, 20), (-130, -30), (45, 10)):
        count, duration_s, depth = camera.settle(yaw_deg, pitch_deg)
        counts.append(count)
        seconds.append(duration_s)
        depths.append(depth)
    name = "pose settles"
    if max(counts) >= NEVER:
        return Finding(name, "never: the world moves", "bad", "pause the game, stop animations")
    if (depths[0] < UNREAL_SKY).any() and all(alike(depth, depths[0]) for depth in depths[1:]):
        return Finding(name, "never: the camera does not turn", "bad", "vset /action/game/resume")
    stale = max(counts[1:])  # the first frames of a camera may be garbage
    camera.lag = stale
    value = f"{1000 * float(np.median(seconds[1:])):.0f} ms"
    if stale == 0:
        return Finding(name, f"at once, first frame after {value}")
    value = f"stale frames: {stale}, {value}"
    if stale > SETTLED:
        return Finding(name, value, "bad", f"at most {SETTLED} are skipped: raise the frame rate")
    return Finding(name, f"{value}, which recordings skip")


def warm_up(camera: RawCamera) -> Finding:
    """Count the frames after a turn until colours change by less than a level."""
    camera.go(0)
    for _ in range(_WARM):
        camera.pixels("lit")
    camera.go(_BACK_DEG)
    frames = [camera.pixels("lit").astype(np.int16) for _ in range(_WARM + 1)]
    count = 0
    for number, (before, after) in enumerate(pairwise(frames), start=1):
        if np.quantile(np.abs(after - before), _MOST) >= 1:
            count = number
    name = "colours settle"
    if count == 0:
        return Finding(name, "at once")
    if count == _WARM:
        return Finding(name, f"never, in {_WARM} frames", "bad", "fix the exposure; stop animations")
    value = f"after {count} more frames: temporal effects, or exposure"
    return Finding(name, value, "bad", f"--set source_options.warmup={count}")


def manual_exposure(connection: Connection, camera: RawCamera) -> list[Finding]:
    """Report the manual exposure that recordings set, of the ``camera`` of a server's ``connection``.

    Nothing of a server that cannot set it.
    """
    if not connection.supports(EXPOSURE_METHOD):
        return []
    location_cm, _ = Pose.from_angles(camera.position).to_unreal()
    try:
        bias = matching_bias(connection, camera.driver.camera, location_cm)
        value = "no bias matches the game's own"
    except ServerRefusedError as refused:
        bias = None
        value = str(refused)
    if bias is not None:
        return [Finding("manual exposure", f"as bright as the game's own with a bias of {bias:g}")]
    return [Finding("manual exposure", value, "warning", "none: colours have the game's own")]


def normals(camera: RawCamera) -> Finding:
    """Report whether pictures of normals hold directions."""
    camera.go(0)
    try:
        lit = show_light(camera.pixels("normals"))
    except ServerRefusedError as refused:
        return Finding("normals", str(refused), "warning", "none: they are left out")
    value = "the lit image" if lit else "directions"
    return Finding.unless(not lit, "normals", value, "bad", "update the plugin: 1.1.0 has them")


def capabilities(camera: RawCamera) -> Finding:
    """Report whether size, field of view and a vertical pose are as set."""
    camera.go(0, 90)
    can = {
        "sets size": camera.driver.table.can_set_size and camera.size == (EDGE_PX, EDGE_PX),
        "sets field of view": abs(camera.fov_deg - across(*camera.size)) < _PRINTED,
        "points straight up": abs(camera.driver.read("rotation", 3)[0] - 90) < _PRINTED,
    }
    words = []
    for what in can:
        words.append(what if can[what] else f"not: {what}")
    value = ", ".join(words)
    return Finding("capabilities", value if all(can.values()) else f"{value}; recordings allow for it")


def right_eye(connection: Connection, camera: RawCamera) -> list[Finding]:
    """Report a second camera of plugin 0.3.10, over its ``connection``; nothing of another ``camera``'s."""
    (reply,) = connection.texts(["vget /camera/1/location"])
    if camera.driver.table is not LEGACY or reply.startswith("error"):
        return []
    return [Finding("cameras", "two: captures use camera 0, the left eye")]


def sizes(pairs: Pairs, camera: RawCamera) -> Finding:
    """Report whether the pictures of all modes, ``pairs`` of a ``camera``, have one size."""
    by_mode = {}
    for mode in _MODES:
        height, width = pairs[mode][0][0].pixels.shape[:2]
        by_mode[mode] = f"{width} x {height}"
    if len(set(by_mode.values())) == 1:
        return Finding("picture size", f"{by_mode['lit']} px in all modes")
    verdict: Any = "warning" if camera.driver.table is LEGACY else "bad"  # its masks are of the window
    return Finding("picture size", ", ".join(map(" ".join, by_mode.items())), verdict, _WINDOW)


def field_of_view(mode: str, pairs: Pairs, camera: RawCamera, kind: str) -> Finding:
    """Measure a mode's field of view, and whether six of its pictures cover a cube.

    Args:
        mode: what is measured.
        pairs: the pictures, before and after a turn.
        camera: that made them.
        kind: of depth, ``planar`` or ``ray``.
    """
    name = f"field of view, {mode.removeprefix('object_')}"
    mask_fov_deg = camera.driver.mask_fov_deg if mode == "object_mask" else None
    reported = mask_fov_deg or camera.fov_deg
    fov = fitted_fov(pairs[mode], reported, kind if mode == "depth" else "")
    if fov is None:
        return _unmeasured(name, "nothing to align")
    value = f"{fov:.1f} degrees, {reported:.1f} reported"
    if mode == "object_mask" and camera.driver.table is LEGACY and mask_fov_deg is None:
        value += ", by a CameraActor"
    if abs(fov - reported) > 1:
        return Finding(name, value, "bad", "FOV 90 in unrealcv.ini")
    height, width = pairs[mode][0][0].pixels.shape[:2]
    if reported < across(width, height) - _PRINTED:
        return Finding(name, f"{value}: less than 90 up and down", "bad", _WINDOW)
    return Finding(name, value)


def depth_kind(pairs: Pairs, camera: RawCamera) -> tuple[str, Finding]:
    """Measure whether depth is planar or along the ray, by what a turn leaves unchanged.

    ``pairs`` are pictures of a ``camera`` before and after it.
    """
    planar = _mean_misfit(pairs, camera, "planar")
    ray = _mean_misfit(pairs, camera, "ray")
    if planar < ray:
        kind = "planar"
        ratio = ray / planar
    else:
        kind = "ray"
        ratio = planar / ray
    expected, _ = camera.driver.table.depth
    if ratio < 3:
        return expected, _unmeasured("depth is", "ambiguous")
    value = f"{kind}; the other fits {ratio:.0f} times worse"
    return kind, _compared("depth is", value, kind, expected)


def _mean_misfit(pairs: Pairs, camera: RawCamera, kind: str) -> float:
    """Return how badly pictures of depth predict each other if it is of a kind; more than 0, by rounding."""
    misfits = []
    for first, second in pairs["depth"]:
        misfits.append(misfit(first, second, camera.fov_deg, kind))
    return float(np.mean(misfits)) + 1e-6


def depth_unit(camera: RawCamera) -> tuple[str, Finding]:
    """Measure by how much depth straight ahead decreases when the camera moves there."""
    _, expected = camera.driver.table.depth

    def ahead(yaw_deg: float, pitch_deg: float, forward_m: float) -> float:
        """Return the depth in the middle of a picture, in the server's unit, after ``camera.go``."""
        camera.go(yaw_deg, pitch_deg, forward_m)
        depth = camera.pixels("depth")
        return float(depth[depth.shape[0] // 2, depth.shape[1] // 2])

    decreases = []
    for yaw_deg, pitch_deg in FACES.values():
        far = ahead(yaw_deg, pitch_deg, 0.0)
        near = ahead(yaw_deg, pitch_deg, _FORWARD_M)
        if near < far < UNREAL_SKY:
            decreases.append((far - near) / _FORWARD_M)
    if not decreases:
        return expected, _unmeasured("depth unit", "nothing but sky")
    per_m = float(np.median(decreases))
    value = f"{per_m:.4g} less for each metre forward"
    for decrease, unit in _UNITS.items():
        if abs(per_m / decrease - 1) < 0.05:
            return unit, _compared("depth unit", f"{unit}; {value}", unit, expected)
    return expected, Finding("depth unit", f"neither cm nor m: {value}", "bad", _UNKNOWN)


def half_floats(pairs: Pairs, unit: str) -> Finding:
    """Report how coarse the depth of ``pairs`` of pictures is, in the server's ``unit``: ``cm`` or ``m``."""
    depth = np.concatenate([picture.pixels.ravel() for picture in chain(*pairs["depth"])])
    depth = depth[depth < UNREAL_SKY]
    if depth.size == 0:
        return _unmeasured("depth steps", "nothing but sky")
    median = float(np.median(depth))
    dtype = np.float16 if (depth.astype(np.float16) == depth).all() else np.float32
    to_m = 0.01 if unit == "cm" else 1.0
    step_mm = 1000 * to_m * float(np.spacing(dtype(median)))
    value = f"{np.dtype(dtype).name}: {step_mm:.2g} mm at {median * to_m:.2f} m"
    remedy = "none: terraces are the engine's; stay nearer"
    return Finding.unless(step_mm <= 10, "depth steps", value, "warning", remedy)


def masks(connection: Connection, camera: RawCamera, pairs: Pairs) -> Finding:
    """Report whether every colour in a mask belongs to one object.

    Args:
        connection: to the server.
        camera: of it.
        pairs: its pictures.
    """
    table = colors(connection)
    visible: set[Color] = set()
    painted = []  # by mask, the share of its pixels that are not black
    for picture in chain(*pairs["object_mask"]):
        visible.update(color_counts(picture.pixels))
        painted.append(picture.pixels.any(axis=-1).mean())
    changes = _changes_dark_colors(connection, camera, table)
    by_color: dict[Color, list[str]] = {(0, 0, 0): ["background"]}
    for name, color in table.items():
        by_color.setdefault(vertex_color_roundtrip(color) if changes else color, []).append(name)
    equal = [" = ".join(names) for names in by_color.values() if len(names) > 1]
    unknown = visible - set(by_color)
    black = 1 - np.mean(painted)
    value = f"{len(table)} objects, {len(visible)} colours visible, {black:.0%} black"
    if changes:
        value += ", dark ones changed"
    if equal:
        remedy = "vset /object/NAME/color R G B, each 0 or 146 to 255"
        return Finding("mask colours", f"{value}; alike: {'; '.join(equal)}", "bad", remedy)
    if unknown:
        value += f"; {len(unknown)} of no object, such as {min(unknown)}"
        return Finding("mask colours", value, "bad", "turn antialiasing off; paint what has no colour")
    return Finding("mask colours", value)


def turned_pairs(camera: RawCamera) -> Pairs:
    """Return pictures in every mode, before and after a turn."""

    def pictures(yaw_deg: float) -> dict[str, Picture]:
        pose = camera.go(yaw_deg)
        return {mode: Picture(camera.pixels(mode), pose) for mode in _MODES}

    pairs: Pairs = {mode: [] for mode in _MODES}
    for yaw_deg in _YAWS_DEG:
        before = pictures(yaw_deg)
        after = pictures(yaw_deg + _TURN_DEG)
        for mode in _MODES:
            pairs[mode].append((before[mode], after[mode]))
    return pairs


def _changes_dark_colors(connection: Connection, camera: RawCamera, table: dict[str, Color]) -> bool:
    """Return whether masks show another dark colour than was set, by the object with the most pixels."""
    name = largest_object(camera, table)
    if name is None:
        return False
    connection.text(paint_command(name, _DARK))
    changes = vertex_color_roundtrip(_DARK) in color_counts(camera.pixels("object_mask"))
    connection.text(paint_command(name, table[name]))
    return changes


def _compared(name: str, value: str, measured: str, expected: str) -> Finding:
    if measured == expected:
        return Finding(name, value)
    return Finding(name, f"{value}; recordings take it as {expected}", "bad", _UNKNOWN)


def _unmeasured(name: str, why: str) -> Finding:
    return Finding(name, why, "warning", "give --position where more is visible")
