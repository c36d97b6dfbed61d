"""The files that docs/calibration.md shows are files of their formats."""

import re
from pathlib import Path

import pytest
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras

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


@pytest.fixture
def shown(tmp_path: Path) -> dict[str, dict[str, cameras.Camera]]:
    """Format: the cameras of the file that its section shows."""
    sections = PAGE.read_text(encoding="utf-8").partition("## OpenCV")[2]
    sections = sections.partition("## Rigs")[0]
    blocks = re.findall(r"^```(?:yaml|text)\n(.*?)^```", sections, re.M | re.S)
    read = {}
    for format, block in zip(EXPECTED, blocks, strict=True):
        (tmp_path / format).write_text(block, encoding="utf-8")
        read[format] = calibration.load(tmp_path / format)
    return read


def test_the_files_shown_hold_what_the_page_says(shown: dict[str, dict[str, cameras.Camera]]) -> None:
    names = {format: {name: camera.name for name, camera in read.items()} for format, read in shown.items()}
    assert names == EXPECTED


def test_one_lens_is_shown_in_three_formats(shown: dict[str, dict[str, cameras.Camera]]) -> None:
    """With its principal point at 639.5 where pixel centres are whole numbers, and 640 where they are not."""
    assert_same_rays(shown["opencv-fisheye"]["cam0"], shown["kalibr"]["cam0"])
    assert_same_rays(shown["opencv-fisheye"]["cam0"], shown["colmap"]["1"])


def test_the_page_names_every_format() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"| `{format}` |" in text for format in calibration.formats())
