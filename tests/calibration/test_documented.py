"""The files that docs/calibration.md shows are files of their formats."""

import re
from pathlib import Path

from support.same_rays import assert_same_rays

from omniscv import calibration

PAGE = Path(__file__).parents[2] / "docs" / "calibration.md"
EXPECTED = {
    "opencv-fisheye": {"cam0": "kannala-brandt"},
    "opencv-omnidir": {"cam0": "unified"},
    "kalibr": {"cam0": "kannala-brandt", "cam1": "catadioptric-hyperbolic", "cam2": "double-sphere"},
    "colmap": {"1": "kannala-brandt", "2": "equirectangular"},
    "ocamcalib": {"cam0": "scaramuzza"},
    "aria": {"camera-slam-left": "fisheye624"},
    "isaac": {"front": "ftheta"},
    "ncore": {"cam0": "ftheta"},
}


def test_the_page_shows_files_of_every_format(tmp_path: Path) -> None:
    """One lens in three formats: its principal point is 639.5 where pixel centres are whole numbers."""
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"| `{format}` |" in page for format in calibration.formats())
    sections = page.partition("## OpenCV")[2].partition("## Rigs")[0]
    blocks = re.findall(r"^```(?:yaml|text)\n(.*?)^```", sections, re.M | re.S)
    shown = {}
    for format, block in zip(EXPECTED, blocks, strict=True):
        (tmp_path / format).write_text(block, encoding="utf-8")
        shown[format] = calibration.load(tmp_path / format)
    names = {format: {name: camera.name for name, camera in read.items()} for format, read in shown.items()}
    assert names == EXPECTED
    assert_same_rays(shown["opencv-fisheye"]["cam0"], shown["kalibr"]["cam0"])
    assert_same_rays(shown["opencv-fisheye"]["cam0"], shown["colmap"]["1"])
