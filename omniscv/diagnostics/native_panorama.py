"""A server's own panorama, compared with one from six faces of its camera at the same place.

Only closed builds have panoramas, and no document says where they begin, which way they turn and what their
depth means. Nothing here is used for captures: the findings say how such a picture would be converted.
"""

import io
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from omniscv.arguments import shown
from omniscv.diagnostics import Finding
from omniscv.diagnostics.self_calibration import GREY, Picture, sample
from omniscv.diagnostics.server import FACES, RawCamera
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.geometry import Array
from omniscv.sources.codecs import UNREAL_SKY
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.protocol import Reply
from omniscv.sources.unreal.shared_memory import SharedPictures, region_reader

COLORS = "vget /camera/[uint]/panoramic [str] [uint] [uint]"
DEPTH = "vget /camera/[uint]/panoramic/depth_shared [uint] [uint]"
_SIZE = 256, 128
_TURNED_DEG = 50.0  # of the camera, to see whether its panorama turns with it
_STEEPEST = 0.6  # radians up and down within which panoramas are compared: rows near the poles hold little
_ALIKE = 0.6  # correlation from which two panoramas show the same
_NEAR_PX = 0.2


class _Fit(NamedTuple):
    """How columns and rows of a panorama look: yaw to the left of column 0's edge, and shifts in px."""

    turns: int  # 1: columns go to the left, -1: to the right
    yaw_deg: float
    row_px: float
    correlation: float


def findings(connection: Connection, camera: RawCamera) -> list[Finding]:
    """Compare a server's panorama with ours; nothing for a server without one."""
    if not connection.supports(COLORS):
        return []
    name = "its own panorama"
    faces = [_face(camera, yaw, pitch, "lit") for yaw, pitch in FACES.values()]
    try:
        first, second = (_fit(_colors(connection, camera, yaw), faces, camera) for yaw in (0.0, _TURNED_DEG))
    except (BadReplyError, ServerRefusedError) as fault:
        return [Finding(name, str(fault), "warning", "none: captures do not use it")]
    if min(first.correlation, second.correlation) < _ALIKE:
        return [Finding(name, "does not show what six faces show", "warning", "do not use it")]
    turned = (second.yaw_deg - first.yaw_deg + 180) % 360 - 180
    column = (first.turns * -first.yaw_deg / 360 * _SIZE[0]) % _SIZE[0]
    half = abs(first.row_px - 0.5) < _NEAR_PX
    words = (
        f"world yaw 0 at column {column:.1f} of {_SIZE[0]}",
        f"columns turn {'left' if first.turns > 0 else 'right'}",
        "follows the camera" if abs(turned - _TURNED_DEG) < 2 else "world axes",
        f"rows {'at pixel centres' if half else 'at corners'} ({first.row_px:+.2f} px)",
    )
    value = ", ".join(words)
    return [Finding(name, f"{value}; captures do not use it"), *_depth(connection, camera, first)]


def _face(camera: RawCamera, yaw_deg: float, pitch_deg: float, mode: str) -> Picture:
    pose = camera.go(yaw_deg, pitch_deg)
    pixels = camera.pixels(mode)
    return Picture(pixels @ GREY if mode == "lit" else pixels, pose)


def _colors(connection: Connection, camera: RawCamera, yaw_deg: float) -> Array:
    """Return (H, W) grey levels of the server's panorama, with the camera at a yaw."""
    camera.go(yaw_deg)

    def grey(command: str, reply: Reply) -> Array:
        return np.asarray(bmp_colors(reply, *_SIZE) @ GREY)

    width, height = _SIZE
    return connection.read([f"vget /camera/{camera.driver.camera}/panoramic bmp {width} {height}"], grey)[0]


def bmp_colors(reply: Reply, width: int, height: int) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of a BMP of 32 bits; BadReplyError for another size.

    Open plugins repeat the byte count behind a header of 54 bytes, Dev builds do not. The pixels come last.
    """
    count = 4 * width * height
    if not isinstance(reply, bytes) or not reply.startswith(b"BM") or len(reply) - count not in (54, 58):
        raise BadReplyError(f"expected a BMP of {width} x {height}, got {shown(reply[:100])}")
    return np.frombuffer(reply[-count:], np.uint8).reshape(height, width, 4)[..., 2::-1]


def _directions(fit: _Fit) -> Array:
    """Return (H, W, 3) world directions of the middle rows, for the convention of a fit."""
    width, height = _SIZE
    yaw = np.radians(fit.yaw_deg) + fit.turns * 2 * np.pi * np.arange(width) / width
    pitch = np.pi * (0.5 - (np.arange(height) + fit.row_px) / height)
    pitch = pitch[_middle()]
    pitch, yaw = np.meshgrid(pitch, yaw, indexing="ij")
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)


def _middle() -> NDArray[np.bool_]:
    """Return (H,) the rows that are compared."""
    height = _SIZE[1]
    return np.asarray(np.abs(np.pi * (0.5 - (np.arange(height) + 0.5) / height)) < _STEEPEST)


def _seen(faces: list[Picture], camera: RawCamera, directions: Array) -> Array:
    """Return (...) what faces show in directions, bilinear."""
    axes = np.array([face.pose.R_w_c[:, 2] for face in faces])
    nearest = (directions @ axes.T).argmax(axis=-1)
    result = np.empty(nearest.shape)
    for number, face in enumerate(faces):
        if not (there := nearest == number).any():
            continue
        uvz = face.view(camera.fov_deg).project(directions[there] + face.pose.position)
        result[there] = sample(face.pixels, uvz[None])[0]
    return result


def _fit(theirs: Array, faces: list[Picture], camera: RawCamera) -> _Fit:
    """Find the convention by correlation: columns by FFT for either direction, then fractions of a pixel."""
    theirs = theirs[_middle()]
    fits = []
    for turns in (1, -1):
        ours = _seen(faces, camera, _directions(_Fit(turns, 0.0, 0.5, 0.0)))
        spectra = [np.fft.rfft(rows - rows.mean(axis=1, keepdims=True), axis=1) for rows in (theirs, ours)]
        score = np.fft.irfft((spectra[0].conj() * spectra[1]).sum(axis=0), _SIZE[0])
        fits.append((float(score.max()), turns, float(score.argmax()) * turns * 360 / _SIZE[0]))
    _, turns, yaw_deg = max(fits)

    def misfit(yaw_and_row: Array) -> float:
        ours = _seen(faces, camera, _directions(_Fit(turns, yaw_and_row[0], yaw_and_row[1], 0.0)))
        return 1 - float(np.corrcoef(ours.ravel(), theirs.ravel())[0, 1])

    pixel = 360 / _SIZE[0]
    bounds = [(yaw_deg - pixel, yaw_deg + pixel), (-0.75, 1.25)]
    best = minimize(misfit, (yaw_deg, 0.25), method="Powell", bounds=bounds, options={"xtol": 1e-3})
    yaw_deg, row_px = best.x.tolist()
    return _Fit(turns, yaw_deg, row_px, 1 - float(best.fun))


def _depth(connection: Connection, camera: RawCamera, fit: _Fit) -> list[Finding]:
    """Measure kind and unit of a panorama's depth; nothing where this process cannot read it."""
    read = region_reader(connection.endpoint)
    if read is None or not connection.supports(DEPTH):
        return []
    kind, unit = camera.driver.table.depth
    faces = []
    for yaw, pitch in FACES.values():
        face = _face(camera, yaw, pitch, "depth")
        lengths = face.view(camera.fov_deg).ray_lengths() if kind == "planar" else 1.0
        metres = np.where(
            face.pixels < UNREAL_SKY, face.pixels * lengths * (0.01 if unit == "cm" else 1.0), np.nan
        )
        faces.append(Picture(metres, face.pose))
    camera.go(0)
    command = "vget /camera/{}/panoramic/depth_shared {} {}".format(camera.driver.camera, *_SIZE)
    payload = SharedPictures(read).payload(connection.text(command))
    theirs: NDArray[Any] = np.load(io.BytesIO(payload), allow_pickle=False)[_middle()]
    directions = _directions(fit)
    planar = np.abs(directions).max(axis=-1)  # of a cube along the world's axes; the camera looks along one
    ratio = np.log(np.maximum(theirs, 1e-6) / _seen(faces, camera, directions))
    known = np.isfinite(ratio) & (theirs < UNREAL_SKY)
    spread = {"ray": _spread(ratio[known]), "planar": _spread((ratio - np.log(planar))[known])}
    best = min(spread, key=spread.__getitem__)
    scale = float(np.exp(np.median((ratio - (np.log(planar) if best == "planar" else 0))[known])))
    name = {100.0: "cm", 1.0: "m"}.get(round(scale, 0), f"{scale:.3g} of a metre")
    other = max(spread.values()) / max(spread[best], 1e-6)
    return [Finding("its panorama's depth", f"{best}, {name}; the other fits {other:.0f} times worse")]


def _spread(values: Array) -> float:
    """Return the middle half's width: edges differ."""
    return float(np.ptp(np.quantile(values, (0.25, 0.75))))
