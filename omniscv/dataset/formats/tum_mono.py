"""Photometric calibration as in TUM's monocular visual odometry datasets, which DSO reads.

Each camera has a folder of its pictures behind the sensor, in the order of their times::

    CAMERA/images/00000.png ...   the layer 'sensor'
    CAMERA/times.txt              a line for each picture: number, seconds, milliseconds of exposure
    CAMERA/pcalib.txt             light, 0 to 255, of each code: the inverse of sRGB
    CAMERA/vignette.png           16 bits: the sensor's shading, or white
    CAMERA/camera.txt             the lens, where DSO has its model

:mod:`omniscv.sensor.optics` reads and writes these files.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.calibration.table import DSO
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.rig import RigCamera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import without_limit, write_pixels
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry.clock import NS
from omniscv.records import checked, mapping, optional, record
from omniscv.sensor import Sensor, optics
from omniscv.storage.local import write_text


@record
class TumMonoOptions:
    """Options of the format."""

    sensor: Mapping[str, Any] | None = checked(
        optional(mapping), default=None, help="the job's sensor, whose exposure and shading are written"
    )


@register
class TumMono(Format):
    """See the module."""

    name = "tum_mono"
    needs = ("sensor",)
    keys = ("sensor",)
    options = TumMonoOptions

    def check_options(self, options: TumMonoOptions, cameras: Mapping[str, Camera]) -> None:
        """Refuse shading of a file, which is a vignette already."""
        if isinstance((options.sensor or {}).get("shading"), Mapping):
            wanted = "expected natural shading or a table"
            raise ArgumentError(
                f"tum_mono: {wanted}, got a file, which is the vignette; leave the format out"
            )

    def write(self, frames: Sequence[Frame], out: Path, options: TumMonoOptions) -> list[Path]:
        sensor, written = Sensor(**(options.sensor or {})), []
        for name, mine in by_camera(frames).items():
            folder, camera = out / name, mine[0].camera
            numbered = [(f"{i:05d}", frame) for i, frame in enumerate(mine)]
            for number, frame in numbered:
                written.append(write_pixels(folder / "images" / f"{number}.png", frame.layer("sensor")))
            times = [
                (number, i * NS if frame.time_ns is None else frame.time_ns, sensor.exposure_s)
                for i, (number, frame) in enumerate(numbered)
            ]
            shares = np.ones((camera.height, camera.width))
            if sensor.shading is not None:
                shares = np.asarray(optics.shading(camera, sensor.shading), np.float64)
            lens = without_limit(camera.base if isinstance(camera, RollingShutter) else camera)
            with suppress(ArgumentError):  # DSO has no such model
                written.append(write_text(folder / "camera.txt", DSO.write({name: RigCamera(lens)})))
            written += [
                optics.write_times(folder / optics.TIMES, times),
                optics.write_response(folder / optics.RESPONSE, "srgb"),
                optics.write_vignette(folder / optics.VIGNETTE, shares),
            ]
        return written
