"""The files that docs/calibration.md shows are files of their formats."""

import re
from pathlib import Path

from support.same_rays import assert_same_rays

from omniscv import calibration
from omniscv.calibration.files import FORMS
from omniscv.calibration.keys import parts

PAGE = Path(__file__).parents[2] / "docs" / "calibration.md"
EXPECTED = {
    "opencv-fisheye": {"cam0": "kannala-brandt"},
    "opencv-omnidir": {"cam0": "unified"},
    "kalibr": {"cam0": "kannala-brandt", "cam1": "unified", "cam2": "double-sphere"},
    "colmap": {"1": "kannala-brandt", "2": "equirectangular"},
    "ocamcalib": {"cam0": "scaramuzza"},
    "aria": {"camera-slam-left": "fisheye624"},
    "isaac": {"front": "ftheta"},
    "ncore": {"cam0": "ftheta"},
}


def markdown() -> str:
    """The table of docs/lens-files.md: every form, from its row."""
    lines = [
        "| format | programs | their models and ours | pixel centres at | poses | not carried |",
        "|---|---|---|---|---|---|",
    ]
    for form in FORMS.values():
        by_model: dict[str, list[str]] = {}
        models = form.layout.models
        both = {(model.words, model.name) for model in models if not model.read_only}
        for model in models:
            if model.read_only and (model.words, model.name) in both:  # the same in another spelling
                continue
            word = "-".join(parts((model.words or ("",))[0]))
            read_only = " (read only)" if form.written and model.read_only else ""
            by_model.setdefault(model.name.removesuffix("-inverse"), []).append(word + read_only)
        words = {name: ", ".join(dict.fromkeys(filter(None, theirs))) for name, theirs in by_model.items()}
        ours = "; ".join(f"{theirs} `{name}`".strip() for name, theirs in words.items()) or "every model"
        cells = [f"`{form.name}`" + ("" if form.written else ", read only"), form.programs, ours]
        cells += [".5" if form.layout.shift_px == 0 else "whole numbers"]
        cells += ["yes" if form.layout.poses else "", form.refused]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def test_the_table_of_lens_files_is_that_of_the_rows() -> None:
    """It is written anew by ``python tests/calibration/test_documented.py``."""
    assert markdown() in (PAGE.parent / "lens-files.md").read_text(encoding="utf-8")


def test_the_page_shows_files_of_every_format(tmp_path: Path) -> None:
    """One lens in three formats: its principal point is 639.5 where pixel centres are whole numbers."""
    page = PAGE.read_text(encoding="utf-8")
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


if __name__ == "__main__":
    table = PAGE.parent / "lens-files.md"
    before, after = re.split(r"^\|.*\|$", table.read_text(encoding="utf-8"), flags=re.M | re.S)
    table.write_text(before + markdown().rstrip() + after, encoding="utf-8")
