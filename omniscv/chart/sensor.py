"""Photon transfer curves of the presets of sensors: variance of pixels by their mean, measured and due."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from omniscv.chart import drawing
from omniscv.progress import Steps, counted
from omniscv.sensor import PRESETS, Sensor

TITLE = "Photon transfer: temporal variance by mean. Dots: measured. Lines: due by EMVA 1288"
QUICK = {"width": 32}

_LEVELS = 25
_DARKEST = 1e-4  # of the full well, the first level
_BRIGHTEST = 0.8  # of the full well, the last level: above it the well clips the noise
_HEIGHT_IN = 4.5


@dataclass(frozen=True)
class Row:
    """A level of light on a sensor.

    Attributes:
        preset: of the sensor.
        electrons: of each pixel.
        mean, variance: of the codes of two frames, less the black level.
        due: the variance by the standard.
    """

    preset: str
    electrons: float
    mean: float
    variance: float
    due: float


def measure(width: int = 256, progress: Steps | None = None) -> list[Row]:
    """Expose two even frames of every preset at every level.

    Args:
        width: of the square frames, px.
        progress: called with (presets done, presets in total).
    """
    rows = []
    for name in counted(list(PRESETS), progress):
        sensor = replace(Sensor(preset=name), mosaic="mono", prnu=0.0)  # PRNU is not temporal noise
        for electrons in np.geomspace(_DARKEST, _BRIGHTEST, _LEVELS) * sensor.full_well:
            light = np.full((width, width, 3), electrons / sensor.full_well, np.float32)
            one, other = (sensor.expose(light, name, frame).astype(np.float64) for frame in (0, 1))
            dark = sensor.dark_current * sensor.exposure_s
            due = sensor.gain**2 * (electrons + dark + sensor.read_noise**2) + 1 / 12
            mean, variance = (one + other).mean() / 2 - sensor.black_level, np.mean((one - other) ** 2) / 2
            rows.append(Row(name, float(electrons), float(mean), float(variance), float(due)))
    return rows


def write(rows: list[Row], out: Path) -> list[Path]:
    """Draw the curves, and return the files."""
    figure, (axes,) = drawing.figure(1, _HEIGHT_IN, TITLE)
    for name, color, marker in zip(PRESETS, drawing.COLORS, drawing.MARKERS, strict=False):
        mine = [row for row in rows if row.preset == name]
        mean = [max(row.mean, 1e-2) for row in mine]
        axes.loglog(mean, [row.due for row in mine], color=color, lw=1)
        axes.loglog(mean, [row.variance for row in mine], marker, color=color, ms=5, label=name)
    axes.set_xlabel("mean above black, codes")
    axes.set_ylabel("variance, codes squared")
    for axis in (axes.xaxis, axes.yaxis):
        drawing.plain(axis, ticks=(1,))
    axes.grid(True, color="#d5d9e0", lw=0.5)
    axes.legend(frameon=False)
    return drawing.write(rows, figure, out, "chart-sensor")
