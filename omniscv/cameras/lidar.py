"""Turning laser scanners as cameras: rows are channels, columns are firings, depth is the range."""

import csv
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import (
    flag,
    number,
    numbers,
    one_of,
    optional_number,
    shown,
    whole_number,
    within,
    wrong,
)
from omniscv.cameras.base import Array, Camera, Mask, Viewpoints, grid_axes, vectors, viewpoints_by_line
from omniscv.cameras.registry import register
from omniscv.errors import ArgumentError
from omniscv.records import checked, optional, read, record

_MOST_BYTES = 1 << 22  # of a table: those of 128 channels take 20 kB
_STEPS = 60  # of the search for a point's row
_FOUND = 1e-13  # of a row: ends it
_SEEN = 1e-9  # of a row: the search has found one
_EVEN = 1e-3  # of a step: by which column azimuths may differ from equal steps
_RATE = 10.0  # turns a second
_HALF_TURN = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))


@record(eq=False)
class LidarTable:
    """The beams of a sensor in its frame (X forward, Y left, Z up), the highest first.

    Args:
        elevation_deg: (n,) of each channel, decreasing, within +-90.
        azimuth_deg: (n,) of each channel, to the left +, on top of its column's.
        along_m: (n,) where each ray starts, along its level direction; ranges count from there.
        across_m: (n,) the same to the left of that direction.
        up_m: (n,) the same upward.
        delay_s: (n,) from the firing of a column to that of its channel.
        start_deg: azimuth of the first column.
        step_deg: azimuth from a column to the next; None: a turn to the right in equal steps.
        columns: of a turn; None where the table does not say.
        rate: turns a second.
        ring_from_below: whether programs count this sensor's channels from the lowest one.
    """

    elevation_deg: Array = checked(numbers, shape=(None,))
    azimuth_deg: Array = checked(numbers, shape=(None,), default=(0.0,))
    along_m: Array = checked(numbers, shape=(None,), default=(0.0,))
    across_m: Array = checked(numbers, shape=(None,), default=(0.0,))
    up_m: Array = checked(numbers, shape=(None,), default=(0.0,))
    delay_s: Array = checked(numbers, shape=(None,), default=(0.0,))
    start_deg: float = checked(number, default=180.0)
    step_deg: float | None = checked(optional_number, default=None)
    columns: int | None = checked(optional(whole_number), default=None)
    rate: float = checked(number, above=0, default=_RATE)
    ring_from_below: bool = checked(flag, default=False)

    def __post_init__(self) -> None:
        elevation_deg = np.asarray(self.elevation_deg)
        count = len(elevation_deg)
        order = np.argsort(-elevation_deg, kind="stable")
        for name, values in vars(self).items():
            if isinstance(values, np.ndarray | tuple):
                values = np.asarray(values)
                if len(values) not in (1, count):
                    raise ArgumentError(f"{name}: expected {count} numbers, one a channel, got {len(values)}")
                vars(self)[name] = np.broadcast_to(values, count)[order]
        if (np.diff(elevation_deg[order]) == 0).any() or np.abs(elevation_deg).max() >= 90:
            raise wrong("elevation_deg", "different angles within -90 to 90 degrees", self.elevation_deg)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        plain = asdict(self)
        for key, value in plain.items():
            if isinstance(value, np.ndarray):
                plain[key] = value.tolist()
        return plain


def _velodyne(elevation_deg: Array, cycle_s: float, laser_s: float) -> LidarTable:
    """Return the table of a sensor whose lasers, in the order given, fire one after the other."""
    delay_s = laser_s * np.arange(len(elevation_deg))
    turn_deg = -360 * _RATE
    table = {
        "elevation_deg": elevation_deg,
        "azimuth_deg": turn_deg * delay_s,
        "delay_s": delay_s,
        "step_deg": turn_deg * cycle_s,
        "columns": int(1 / (_RATE * cycle_s)),
        "ring_from_below": True,
    }
    return read(LidarTable, table)


def _off_axis(elevation: Any, azimuth_deg: Array, axis_mm: float, up_mm: float, **more: Any) -> LidarTable:
    """Return the table of beams that start on a circle around the axis, at the azimuth of their column."""
    angle = np.radians(azimuth_deg)
    axis_m = axis_mm / 1e3
    table = {
        "elevation_deg": elevation,
        "azimuth_deg": azimuth_deg,
        "along_m": axis_m * np.cos(angle),
        "across_m": -axis_m * np.sin(angle),
        "up_m": np.full(len(azimuth_deg), up_mm / 1e3),
    }
    return read(LidarTable, table | more)


def _ouster(channels: int) -> LidarTable:
    """Return the nominal table of an OS1: 42.4 degrees, beams 15.806 mm from the axis at four azimuths."""
    azimuth_deg = np.resize([-4.2, -1.4, 1.4, 4.2], channels)
    return _off_axis(np.linspace(21.2, -21.2, channels), azimuth_deg, 15.806, 36.18, columns=1024)


_VLP_16 = np.stack([np.arange(-15.0, 0, 2), np.arange(1.0, 16, 2)], axis=1).ravel()
_HDL_32E = (np.stack([np.arange(-92, -31, 4), np.arange(-28, 33, 4)], axis=1) / 3).ravel()
PRESETS = {
    "vlp-16": lambda: _velodyne(_VLP_16, 55.296e-6, 2.304e-6),
    "vlp-16-hires": lambda: _velodyne(_VLP_16 * 2 / 3, 55.296e-6, 2.304e-6),
    "hdl-32e": lambda: _velodyne(_HDL_32E, 46.08e-6, 1.152e-6),
    "os1-64": lambda: _ouster(64),
    "os1-128": lambda: _ouster(128),
}
"""Tables by name. Sources: Velodyne's manuals (as the ROS driver's ``rawdata.h`` has them), Ouster's data
sheet of the OS1."""


@register
class Lidar(Camera):
    """A turning laser scanner at rest, or that a job moves along its path while it turns.

    The ray of (u, v) points, in a frame with X forward and Z up, to ``(cos e cos a, cos e sin a, sin e)``,
    ``a = start + (u - 1/2) step + azimuth(v)``, ``e = elevation(v)``; it starts beside the axis, where the
    table says. Angles between rows are interpolated. Parameters: ``preset``, "vlp-16", "vlp-16-hires",
    "hdl-32e", "os1-64", "os1-128" or the file of a table (Ouster's metadata, Velodyne's YAML, NCore's JSON,
    CSV with columns elevation and azimuth, _deg); or ``table``, the arguments of :class:`LidarTable`;
    ``frozen``, whether all of a scan is of one instant: else a job's sensor moves while it turns.
    Domain: every pixel; the size is the table's if not given. Points are seen from about 0.1 metres on; near
    ones perhaps by two beams of a moving sensor whose channels have azimuths: ``project`` returns the first.
    Source: Ouster SDK, ``xyzlut.cpp``; ROS driver of Velodyne, ``rawdata.cc``.
    """

    name = "lidar"
    typical_aspect = 1 / 8
    typical: ClassVar = {"preset": "os1-64"}
    central = False

    def __init__(
        self,
        width: int | None = None,
        height: int | None = None,
        preset: str | None = None,
        table: Mapping[str, Any] | None = None,
        frozen: bool = False,
    ) -> None:
        self.frozen = flag("frozen", frozen)
        if (preset is None) == (table is None):
            raise ArgumentError(f"preset: expected {', '.join(PRESETS)} or a file; or a table, and not both")
        self.preset = preset if isinstance(preset, str) and preset in PRESETS else None
        self._table = read(LidarTable, table, "table") if preset is None else _table(preset)
        columns = self._table.columns if width is None else width
        if columns is None:
            raise ArgumentError("width: expected the firings in a turn, which the table does not say")
        channels = len(self._table.elevation_deg)
        super().__init__(columns, channels if height is None else height)
        self._channels_a_row = channels / self.height
        self._set_columns()
        self._set_rows()

    def _set_columns(self) -> None:
        """Set azimuth and step of the columns, radians, and how many of them are a turn."""
        step_deg = self._table.step_deg
        self._turn = float(self.width) if step_deg is None else 360 / abs(step_deg)
        if step_deg is None:
            step_deg = -360 / self.width
        self._start = math.radians(self._table.start_deg)
        self._step = math.radians(step_deg)
        if self.width * abs(step_deg) > 360 * (1 + 1e-9):
            most = int(360 / abs(step_deg))
            raise ArgumentError(f"width: expected at most {most} firings, which are a turn, got {self.width}")

    def _set_rows(self) -> None:
        """Set the beams of channels, radians and metres, and elevations half a row beyond the outer ones."""
        beams = self._table
        elevation = np.radians(beams.elevation_deg)
        channels = len(elevation)
        first = (elevation[:1] - elevation[1:2]) / 2
        last = (elevation[-2:-1] - elevation[-1:]) / 2
        if channels == 1:
            first = last = np.full(1, abs(self._step) / 2)
        self._rows = np.concatenate([[-0.5], np.arange(channels), [channels - 0.5]])
        self._elevation = np.concatenate([elevation[:1] + first, elevation, elevation[-1:] - last])
        if np.abs(self._elevation).max() >= np.pi / 2:
            raise ArgumentError("elevation_deg: expected half a row beyond the first and last within +-90")
        self._azimuth = np.radians(beams.azimuth_deg)
        self._offset = np.stack([beams.along_m, beams.across_m, beams.up_m])

    def _arguments(self) -> dict[str, Any]:
        arguments: dict[str, Any] = {"width": self.width, "height": self.height}
        if self.preset:
            arguments["preset"] = self.preset
        else:
            arguments["table"] = self._table.to_dict()
        if self.frozen:
            arguments["frozen"] = True
        return arguments

    @property
    def rate(self) -> float:
        """Turns a second."""
        return self._table.rate

    @property
    def rings(self) -> NDArray[np.uint16]:
        """(H,) the number of each row's channel: from the top, or from below as programs count Velodyne's."""
        channel = ((np.arange(self.height) + 0.5) * self._channels_a_row).astype(np.uint16)  # nearest to it
        return channel.max() - channel if self._table.ring_from_below else channel

    @property
    def readout(self) -> float:
        """Seconds from the first column to one after the last; 0 of a frozen sensor."""
        return 0.0 if self.frozen else self.width / (self._turn * self.rate)

    @property
    def delays(self) -> Array:
        """(n,) seconds from the firing of a column to that of each channel."""
        return self._table.delay_s

    def delay(self, rows: Array) -> Array:
        """Return the same at rows (...) of the image, px, between channels by interpolation."""
        at = rows * self._channels_a_row - 0.5
        return np.asarray(np.interp(at, self._rows[1:-1], self._table.delay_s))

    def seconds(self) -> Array:
        """Return (H, W) seconds from the first column's firing to each; 0 of a frozen sensor."""
        rows = np.arange(0.5, self.height)[:, None]
        times = np.arange(self.width) / (self._turn * self.rate) + self.delay(rows)
        return np.zeros_like(times) if self.frozen else times

    def _beam(self, row: Array) -> tuple[Array, Array, Array]:
        """Return azimuth, and the start along, across and up (3, ...), of rows, counted in channels."""
        channels = self._rows[1:-1]
        start = np.stack([np.interp(row, channels, offset) for offset in self._offset])
        return np.interp(row, channels, self._azimuth), start, np.interp(row, self._rows, self._elevation)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, bool]:
        u, v = grid_axes(pixels)
        azimuth, (along, across, up), elevation = self._beam(v * self._channels_a_row - 0.5)
        azimuth = self._start + (u - 0.5) * self._step + azimuth
        cos = np.cos(azimuth)
        sin = np.sin(azimuth)
        level = np.cos(elevation)
        origins = vectors(across * -cos - along * sin, -up, along * cos - across * sin)
        return origins, vectors(-level * sin, -np.sin(elevation), level * cos), True

    def _project(self, points: Array) -> tuple[Array, Mask]:
        X = points[..., 2]
        Y = -points[..., 0]
        Z = -points[..., 1]
        from_axis = np.hypot(X, Y)
        row = np.interp(-np.arctan2(Z, from_axis), -self._elevation, self._rows)
        moved = np.full(row.shape, np.inf)
        reach = from_axis
        across = np.zeros_like(from_axis)
        for _ in range(_STEPS):  # the start of the ray depends on the row: a fixed point
            if not (moved > _FOUND * len(self._azimuth)).any():
                break
            _, (along, across, up), _ = self._beam(row)
            reach = np.sqrt((from_axis - across) * (from_axis + across))
            elevation = np.arctan2(Z - up, reach - along)
            again = np.interp(-elevation, -self._elevation, self._rows)
            moved = np.abs(again - row)
            row = again
        azimuth, (along, across, up), _ = self._beam(row)
        elevation = np.arctan2(Z - up, reach - along)
        inside = (elevation <= self._elevation[0] + _FOUND) & (elevation >= self._elevation[-1] - _FOUND)
        column = (np.arctan2(Y, X) - np.arctan2(across, reach) - azimuth - self._start) / self._step + 0.5
        column -= self._turn * np.round((column - self.width / 2) / self._turn)
        seen = inside & (reach > along) & (moved <= _SEEN)
        return np.stack([column, (row + 0.5) / self._channels_a_row], axis=-1), seen

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per column, the mean of its channels', or at most ``count``."""
        origins, _, _ = self._unproject(self.pixels())
        return viewpoints_by_line(origins.mean(axis=0), np.ones(origins.shape[:2], bool), 1, count)


# -- files of tables -------------------------------------------------------------------------------------


def _table(preset: str) -> LidarTable:
    """Return the table of a preset, or of a file."""
    if isinstance(preset, str) and preset in PRESETS:
        return PRESETS[preset]()
    if not isinstance(preset, str) or not preset.endswith((".json", ".yaml", ".yml", ".csv")):
        one_of("preset", preset, (*PRESETS, "FILE.json", "FILE.yaml", "FILE.csv"))
    path = Path(preset)
    from omniscv.storage import bounded  # loads YAML

    with within(preset):
        try:
            content = bounded.read_bytes(path, _MOST_BYTES)
            if path.suffix == ".csv":
                return _of_csv(bounded.decode_text(content))
            if path.suffix == ".json":
                return _of_keys(bounded.parse_json(content))
            return _of_keys(bounded.parse_yaml(bounded.decode_text(content)))
        except ArgumentError:
            raise
        except (ValueError, KeyError, TypeError, AttributeError) as cause:
            wanted = "expected beam_altitude_angles, row_elevations_rad, lasers, or CSV with elevation_deg"
            raise ArgumentError(f"{wanted}; got {type(cause).__name__}: {shown(str(cause))}") from cause


def _of_keys(document: Mapping[str, Any]) -> LidarTable:
    """Return the table of a JSON or YAML file, whose keys may stand in sections."""
    keys: dict[str, Any] = {}
    for section in (document, *document.values()):
        if isinstance(section, Mapping):
            keys |= section
    if "beam_altitude_angles" in keys:
        return _of_ouster(keys)
    return _of_ncore(keys) if "row_elevations_rad" in keys else _of_velodyne(keys)


def _of_ouster(keys: Mapping[str, Any]) -> LidarTable:
    """Metadata of an Ouster sensor. Source: ``xyzlut.cpp``."""
    columns, rate = map(int, str(keys.get("lidar_mode", "1024x10")).split("x"))
    origin_mm = keys.get("lidar_origin_to_beam_origin_mm")
    up_mm = 0.0
    if "beam_to_lidar_transform" in keys:
        matrix = numbers("beam_to_lidar_transform", keys["beam_to_lidar_transform"], (16,)).reshape(4, 4)
        origin_mm = matrix[0, 3]
        up_mm = matrix[2, 3]
    to_sensor = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]
    matrix = numbers("lidar_to_sensor_transform", keys.get("lidar_to_sensor_transform", to_sensor), (16,))
    turn = matrix.reshape(4, 4)[:3, :3]
    moved_mm = matrix.reshape(4, 4)[:3, 3]
    if np.abs(turn - _HALF_TURN).max() > 1e-6 or np.abs(moved_mm[:2]).max() > 1e-6:
        raise wrong("lidar_to_sensor_transform", "half a turn about Z", matrix)
    azimuth_deg = -numbers("beam_azimuth_angles", keys["beam_azimuth_angles"], (None,))
    origin_mm = number("lidar_origin_to_beam_origin_mm", origin_mm)
    up_mm += moved_mm[2]
    return _off_axis(
        keys["beam_altitude_angles"], azimuth_deg, origin_mm, up_mm, columns=columns, rate=float(rate)
    )


def _of_velodyne(keys: Mapping[str, Any]) -> LidarTable:
    """Calibration of the ROS driver: ``lasers``, each with corrections in radians and metres."""
    names = ("vert_correction", "rot_correction", "horiz_offset_correction", "vert_offset_correction")
    rows = []
    for laser in keys["lasers"]:
        rows.append([laser.get(name, 0.0) for name in names])
    vertical, turn, across, up = numbers("lasers", rows, (None, 4)).T
    table = {
        "elevation_deg": np.degrees(vertical),
        "azimuth_deg": np.degrees(turn),
        "across_m": across,
        "along_m": -up * np.sin(vertical),
        "up_m": up * np.cos(vertical),
        "ring_from_below": True,
    }
    return read(LidarTable, table)


def _of_ncore(keys: Mapping[str, Any]) -> LidarTable:
    """NVIDIA's ``RowOffsetStructuredSpinningLidarModelParameters``, which gsplat takes, too."""
    columns = np.unwrap(numbers("column_azimuths_rad", keys["column_azimuths_rad"], (None,)))
    step = (columns[-1] - columns[0]) / max(len(columns) - 1, 1)
    even = columns[0] + step * np.arange(len(columns))
    if step == 0 or np.abs(columns - even).max() > _EVEN * abs(step):
        raise wrong("column_azimuths_rad", "equal steps", keys["column_azimuths_rad"])
    rows = len(keys["row_elevations_rad"])
    elevation = numbers("rows", keys["row_elevations_rad"], (rows,))
    azimuth = numbers("rows", keys.get("row_azimuth_offsets_rad") or [0.0] * rows, (rows,))
    table = {
        "elevation_deg": np.degrees(elevation),
        "azimuth_deg": np.degrees(azimuth),
        "start_deg": math.degrees(columns[0]),
        "step_deg": math.degrees(step),
        "columns": len(columns),
        "rate": keys.get("spinning_frequency_hz", _RATE),
    }
    return read(LidarTable, table)


def _of_csv(text: str) -> LidarTable:
    """A line of names, then a line for each channel: ``elevation_deg``, ``azimuth_deg`` (to the left +)."""
    rows = list(csv.DictReader(text.splitlines(), skipinitialspace=True))
    if not rows or not {*rows[0]} <= {"elevation_deg", "azimuth_deg"}:
        line = shown(text.partition("\n")[0])
        raise ArgumentError(f"expected columns elevation_deg, azimuth_deg, got {line}")
    table = {}
    for name in rows[0]:
        table[name] = [row[name] for row in rows]
    return read(LidarTable, table)
