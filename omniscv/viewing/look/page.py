"""The page: one HTML file with its style, its programs and its data; frames may lie beside it.

A page opened as a file may not read other files, but it may load programs: frames beside it are ``.js`` files
that call one function of the page with their data. No text of a frame is ever part of a program or of markup:
it is JSON in which ``<`` is escaped.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, TextIO

from omniscv.compose.files import finite
from omniscv.dataset import Frame
from omniscv.storage.local import folder_beside, replace_folder, whole_file
from omniscv.viewing.look import layers, outlines
from omniscv.viewing.look.directions import describe
from omniscv.viewing.look.gathering import Gathered
from omniscv.viewing.look.palette import color, ramps

_ASSETS = files("omniscv.viewing.look") / "assets"
_PROGRAMS = (
    "titles",
    "codec",
    "geometry",
    "camera",
    "frames",
    "gpu",
    "painter",
    "view",
    "overlay",
    "plan",
    "probe",
    "panel",
    "controls",
    "bar",
    "main",
    "start",
)
_PLACEHOLDER = re.compile(r"\{\{(\w+)\}\}")

Progress = Callable[[int, int], None]


def write(
    gathered: Gathered, out: Path, title: str, most_pixels: int, progress: Progress | None = None
) -> list[Path]:
    """Write a page, and the frames beside it where they are many.

    Args:
        gathered: what it shows.
        out: the HTML file.
        title: of the page.
        most_pixels: of frames in the page itself; the frames of more lie beside it.
        progress: called with (frames done, frames in all).

    Returns:
        The files, the page first.

    Raises:
        ArgumentError: a frame cannot be read.
    """
    frames = gathered.frames
    pixels = sum(frame.camera.width * frame.camera.height for frame in frames)
    out.parent.mkdir(parents=True, exist_ok=True)
    if pixels <= most_pixels:
        _write(gathered, out, title, None, progress)
        return [out]
    beside = out.with_suffix(".frames")
    with folder_beside(beside) as part:
        _write(gathered, out, title, part, progress)
        replace_folder(part, beside)
    return [out, *sorted(beside.iterdir())]


def _write(gathered: Gathered, out: Path, title: str, beside: Path | None, progress: Progress | None) -> None:
    """Write the page, with its frames or with these in a folder."""
    frames, ranges = gathered.frames, _Ranges()

    def place(file: TextIO) -> None:
        for i, frame in enumerate(frames):
            data = _frame(frame)
            ranges.widen(data["layers"])
            if beside is None:
                file.write(f'<script type="application/json" id="frame-{i}">{_json(data)}</script>\n')
            else:
                (beside / f"{i:05d}.js").write_text(f"lookFrame({i},{_json(data)})\n", encoding="utf-8")
            if progress:
                progress(i + 1, len(frames))

    with whole_file(out) as part, part.open("w", encoding="utf-8") as file:
        for text, name in _pieces(_asset("page.html")):
            file.write(text)
            if name == "frames":
                place(file)
            elif name == "data":
                folder = None if beside is None else f"{out.stem}.frames"
                file.write(_json(_shared(gathered, title, ranges.found, folder)))
            elif name:
                file.write(_part(name))


def _pieces(page: str) -> Iterator[tuple[str, str]]:
    """Texts of a page, each with the name of the placeholder after it; the last one has none."""
    start = 0
    for found in _PLACEHOLDER.finditer(page):
        yield page[start : found.start()], found[1]
        start = found.end()
    yield page[start:], ""


def _part(name: str) -> str:
    """A part of the page that is the same in all pages."""
    if name == "style":
        return _asset("page.css")
    if name == "programs":
        return "\n".join(_asset(f"{each}.js") for each in _PROGRAMS)
    return _asset(f"{name}.glsl")


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _frame(frame: Frame) -> dict[str, Any]:
    """What is shown of a frame."""
    return {"layers": layers.packed(frame), "boxes": outlines.boxes(frame), "layout": outlines.layout(frame)}


def _shared(
    gathered: Gathered, title: str, ranges: Mapping[str, list[float]], folder: str | None
) -> dict[str, Any]:
    """What all frames share, and a line for each."""
    cameras = {frame.camera_name: frame.camera for frame in gathered.frames}
    described = {name: {"name": name, **describe(camera)} for name, camera in cameras.items()}
    if gathered.flat:
        described = {name: {**each, "sphere": None} for name, each in described.items()}
    first = gathered.frames[0]
    found = dict.fromkeys(name for frame in gathered.frames for name in layers.names(frame))
    table = first.classes
    return {
        "title": title,
        "folder": folder,
        "placed": gathered.placed,
        "cameras": described,
        "frames": [_line(frame) for frame in gathered.frames],
        "layers": [{"name": name, "form": layers.form(name)} for name in found],
        "ranges": ranges,
        "ramps": ramps(),
        "labels": {
            str(label): {
                "name": name,
                "color": color(label),
                "mask": gathered.mask_colors.get(name),
                "class": table and table.of_object.get(name),
            }
            for name, label in first.instances.items()
        },
        "classes": {
            str(each.id): {"name": each.name, "color": color(i)}
            for i, each in enumerate(table.classes.values() if table else (), start=1)
        },
    }


def _line(frame: Frame) -> dict[str, Any]:
    return {
        "key": frame.key,
        "camera": frame.camera_name,
        "position": frame.pose.position.tolist(),
        "rotation": frame.pose.rotation.tolist(),
        "time": frame.time,
        "place": frame.place,
        "split": frame.split,
    }


class _Ranges:
    """The least and the largest number of each layer, but for the last 0.5 % of both ends."""

    def __init__(self) -> None:
        self.found: dict[str, list[float]] = {}

    def widen(self, packed: Mapping[str, Mapping[str, Any]]) -> None:
        for name, layer in packed.items():
            if ends := layer.get("range"):
                low, high = self.found.get(name, ends)
                self.found[name] = [min(low, ends[0]), max(high, ends[1])]


def _json(data: object) -> str:
    """Plain values as JSON that is safe within an element ``script``, and in a program."""
    text = json.dumps(finite(data), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
