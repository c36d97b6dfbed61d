"""Calibration files of other programs: OpenCV, Kalibr, COLMAP, OCamCalib, Aria, Isaac Sim, NCore.

The module of each format says what it carries, and how its pixel centres relate to ours, which are at .5.
Readers raise ``ArgumentError`` for text that does not follow the format, writers for cameras, names and poses
that the format cannot carry. Nothing is approximated silently.
"""

from omniscv.calibration.aria import read_aria, rig_from_aria, rig_to_aria, write_aria
from omniscv.calibration.colmap import read_colmap, rig_from_colmap, rig_to_colmap, write_colmap
from omniscv.calibration.files import (
    FormatName,
    RigFormat,
    formats,
    load,
    load_rig,
    read_json,
    save,
    save_rig,
    write_json,
)
from omniscv.calibration.fitting import Fit, fit
from omniscv.calibration.kalibr import read_kalibr, rig_from_kalibr, rig_to_kalibr, write_kalibr
from omniscv.calibration.nvidia import read_isaac, read_ncore, write_isaac, write_ncore
from omniscv.calibration.ocamcalib import read_ocamcalib, write_ocamcalib
from omniscv.calibration.opencv import (
    from_opencv,
    from_opencv_fisheye,
    from_opencv_omnidir,
    read_opencv,
    read_opencv_fisheye,
    read_opencv_omnidir,
    to_opencv,
    to_opencv_fisheye,
    to_opencv_omnidir,
    write_opencv,
    write_opencv_fisheye,
    write_opencv_omnidir,
)

__all__ = [
    "Fit",
    "FormatName",
    "RigFormat",
    "fit",
    "formats",
    "from_opencv",
    "from_opencv_fisheye",
    "from_opencv_omnidir",
    "load",
    "load_rig",
    "read_aria",
    "read_colmap",
    "read_isaac",
    "read_json",
    "read_kalibr",
    "read_ncore",
    "read_ocamcalib",
    "read_opencv",
    "read_opencv_fisheye",
    "read_opencv_omnidir",
    "rig_from_aria",
    "rig_from_colmap",
    "rig_from_kalibr",
    "rig_to_aria",
    "rig_to_colmap",
    "rig_to_kalibr",
    "save",
    "save_rig",
    "to_opencv",
    "to_opencv_fisheye",
    "to_opencv_omnidir",
    "write_aria",
    "write_colmap",
    "write_isaac",
    "write_json",
    "write_kalibr",
    "write_ncore",
    "write_ocamcalib",
    "write_opencv",
    "write_opencv_fisheye",
    "write_opencv_omnidir",
]
