"""The page: one HTML file with its style, its scripts and its data; frames may lie beside it.

A page opened as a file may not read other files, but it may load scripts: frames beside it are ``.js`` files
that call one function of the page with their data. No text of a frame is ever part of a script or of markup:
it is JSON in which ``<`` is escaped.
"""

import json
import re
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from omniscv.compose.files import finite
from omniscv.dataset import Frame
from omniscv.errors import ArgumentError
from omniscv.frame.classes import ClassTable
from omniscv.progress import Steps, counted
from omniscv.storage import is_url
from omniscv.storage.local import folder_beside, replace_folder, whole_file
from omniscv.viewing.look import layers
from omniscv.viewing.look.directions import describe
from omniscv.viewing.look.gathering import Gathered

DEFAULT_SIZE = 1024, 512
MOST_PIXELS = 1 << 23
"""Of frames in the page itself: four panoramas of 2048 x 1024."""


def look(
    what: str | Path,
    out: str | Path = "look.html",
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    most_pixels: int = MOST_PIXELS,
    rerun: str | Path | None = None,
    progress: Steps | None = None,
    warn: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a page that shows images: as a sphere or flat, in every layer.

    Args:
        what: a dataset, a folder that ``render`` wrote, the ``STEM.json`` or a layer of one image, a picture,
            or a recording; a dataset, a picture or a recording also by URL.
        out: the HTML file.
        size: of the panoramas that are composed at the viewpoints of a recording, px.
        most_pixels: frames with more pixels in all are written beside the page, into ``NAME.frames/``.
        rerun: a file NAME.rrd to write, too: the same frames for the Rerun viewer (extra ``rerun``).
        progress: called with (frames done, frames in all).
        warn: called with a line if viewpoints of a recording are left out.

    Returns:
        The files, the page first, and last the one for Rerun.

    Raises:
        ArgumentError: nothing that can be shown, a name that does not end in ``.html``, or no Rerun.
        DatasetError, RecordingError: it is damaged.
        StorageError: a URL cannot be read.
    """
    from omniscv.viewing import rerun_file
    from omniscv.viewing.look import gathering

    target = Path(out)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"out: expected a file NAME.html, got {target.name!r}")
    if rerun is not None:
        rerun_file.check(Path(rerun))
    title = str(what).rstrip("/").rpartition("/")[2] if is_url(what) else Path(what).resolve().name
    with gathering.open_frames(what, size, progress, warn) as gathered:
        written = write(gathered, target, title, most_pixels, progress)
        return written if rerun is None else [*written, rerun_file.write(gathered.frames, Path(rerun))]


_ASSETS = files("omniscv.viewing.look") / "assets"
_SCRIPTS = (
    *("titles", "codec", "geometry", "camera", "frames", "gpu", "painter", "view"),
    *("overlay", "plan", "probe", "panel", "controls", "bar", "main", "start"),
)
_PLACEHOLDER = re.compile(r"\{\{(\w+)\}\}")

_BASE_COLORS = ("#3b82b5", "#e0a43a", "#2f9e7e", "#c986ae", "#7cbfe6", "#cf6a32", "#e3d85e", "#9a8ee0")
"""After Okabe and Ito, whose colours people with any kind of colour vision tell apart, a little paler, with a
violet for their black, which a dark page would hide."""
_MIXES = ((0.0, 0), (0.4, 255), (0.4, 0), (0.65, 255), (0.52, 0), (0.2, 255), (0.2, 0))
"""Share and grey level that are mixed into the base colours in each further turn."""


def write(
    gathered: Gathered, out: Path, title: str, most_pixels: int, progress: Steps | None = None
) -> list[Path]:
    """Write a page, and frames beside it if they are large; return the files, the page first.

    Args:
        gathered: the frames that it shows.
        out: the HTML file.
        title: of the page.
        most_pixels: that frames in the page itself may have in all; frames with more are written beside it.
        progress: called with (frames done, frames in all).
    """
    pixels = sum(frame.camera.width * frame.camera.height for frame in gathered.frames)
    if pixels <= most_pixels:
        _write(gathered, out, title, None, progress)
        return [out]
    beside = out.with_suffix(".frames")
    with folder_beside(beside) as part:
        _write(gathered, out, title, part, progress)
        replace_folder(part, beside)
    return [out, *sorted(beside.iterdir())]


def _write(gathered: Gathered, out: Path, title: str, beside: Path | None, progress: Steps | None) -> None:
    """Write the page, its frames into it or a folder; then its data, as they hold the layers' ranges."""
    ranges: dict[str, list[float]] = {}
    with whole_file(out) as part, part.open("w", encoding="utf-8") as file:
        before, *parts = _PLACEHOLDER.split(_asset("page.html"))
        file.write(before)
        for placeholder, after in zip(parts[::2], parts[1::2], strict=True):
            if placeholder == "frames":
                _write_frames(gathered, file, beside, ranges, progress)
            elif placeholder == "data":
                folder = None if beside is None else f"{out.stem}.frames"
                file.write(_json(_shared(gathered, title, ranges, folder)))
            elif placeholder == "programs":
                file.write("\n".join(_asset(f"{script}.js") for script in _SCRIPTS))
            else:
                file.write(_asset("page.css" if placeholder == "style" else f"{placeholder}.glsl"))
            file.write(after)


def _write_frames(
    gathered: Gathered,
    file: TextIO,
    beside: Path | None,
    ranges: dict[str, list[float]],
    progress: Steps | None,
) -> None:
    """Write the data of all frames, and collect each layer's range, without the last 0.5 % of both ends."""
    for number, frame in enumerate(counted(gathered.frames, progress)):
        packed = layers.packed_layers(frame)
        data = {"layers": packed, "boxes": layers.boxes(frame), "layout": layers.layout(frame)}
        for name, layer in packed.items():
            if ends := layer.get("range"):
                low, high = ranges.get(name, ends)
                ranges[name] = [min(low, ends[0]), max(high, ends[1])]
        if beside is None:
            file.write(f'<script type="application/json" id="frame-{number}">{_json(data)}</script>\n')
        else:
            script = f"lookFrame({number},{_json(data)})\n"
            (beside / f"{number:05d}.js").write_text(script, encoding="utf-8")


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _shared(
    gathered: Gathered, title: str, ranges: Mapping[str, list[float]], folder: str | None
) -> dict[str, Any]:
    """The data that all frames share, and a line for each."""
    cameras = {frame.camera_name: frame.camera for frame in gathered.frames}
    described = {}
    for name, camera in cameras.items():
        described[name] = {"name": name, **describe(camera)}
        if gathered.flat:
            described[name]["sphere"] = None
    names: dict[str, None] = {}
    for frame in gathered.frames:
        names |= dict.fromkeys(layers.names(frame))
    first = gathered.frames[0]
    return {
        "title": title,
        "folder": folder,
        "placed": gathered.placed,
        "cameras": described,
        "frames": list(map(_line, gathered.frames)),
        "layers": [{"name": name, "form": layers.form(name)} for name in names],
        "ranges": ranges,
        "ramps": _ramps(),
        "labels": _labels(first, gathered.mask_colors),
        "classes": {} if first.classes is None else _classes(first.classes),
    }


def _labels(frame: Frame, mask_colors: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return by label the name of its object, its colours in the page and in masks, and its class."""
    labels = {}
    for name, label in frame.instances.items():
        labels[str(label)] = {
            "name": name,
            "color": _color(label),
            "mask": mask_colors.get(name),
            "class": None if frame.classes is None else frame.classes.of_object.get(name),
        }
    return labels


def _classes(table: ClassTable) -> dict[str, dict[str, Any]]:
    """Return by the id of a class its name and colour."""
    classes = {}
    for number, semantic in enumerate(table.classes.values(), start=1):
        classes[str(semantic.id)] = {"name": semantic.name, "color": _color(number)}
    return classes


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


def _color(index: int) -> str:
    """``#rrggbb`` of an object or class, counted from 1: base colours, then paler and darker ones."""
    turn, base = divmod(index - 1, len(_BASE_COLORS))
    share, grey = _MIXES[turn % len(_MIXES)]
    channels = bytes.fromhex(_BASE_COLORS[base].removeprefix("#"))
    return "#" + bytes(round((1 - share) * channel + share * grey) for channel in channels).hex()


def _ramps() -> dict[str, str]:
    """Turbo, red near, and cividis, yellow near: 256 RGB bytes each, as base64."""
    import cv2

    levels = np.arange(255, -1, -1, dtype=np.uint8)[:, None]
    ramps = {}
    for name, ramp in (("turbo", cv2.COLORMAP_TURBO), ("cividis", cv2.COLORMAP_CIVIDIS)):
        bgr = cv2.applyColorMap(levels, ramp)[:, 0]
        ramps[name] = layers.text(bgr[:, ::-1].tobytes())
    return ramps


def _json(data: object) -> str:
    """Plain values as JSON that is safe within an element ``script``, and in a script."""
    text = json.dumps(finite(data), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
