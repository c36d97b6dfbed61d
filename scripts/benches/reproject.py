"""Pictures by another camera, from file to file, beside py360convert and ffmpeg's v360 (by PyAV).

Each way reads JPEG files, shows them by the other camera, bilinear and in the same size, and writes JPEG of
quality 95 (v360: of a quantiser of 2, about as large). Maps are kept by omniscv and v360; py360convert keeps
some. Figures are CPU times of a picture, which other work on the machine changes little; the best of three
turns through the folder.
"""

import shutil
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import av
import cv2
import numpy as np
import py360convert

from benches import Figure, Reference
from omniscv.cli import run

TABLE = "pictures by another camera, CPU time of one"


def measure(quick: bool) -> Iterator[Figure]:
    """Yield the figures of three ways; ``quick`` takes small pictures, once."""
    width = 128 if quick else 2048
    face = width // 4
    flat = ("--camera", "pinhole", "--size", f"{width // 2}x{width // 2}", "--set", "fov_deg=90")
    cube = ("--camera", "cube-map", "--size", f"{3 * face}x{2 * face}", "--set", "layout=3x2")
    panorama = ("--from", "cube-map", "--set-from", "layout=3x2", "--camera", "equirectangular")
    flat_v360 = f"input=e:output=flat:h_fov=90:v_fov=90:w={width // 2}:h={width // 2}"
    ways: dict[str, tuple[bool, tuple[str, ...], Callable[[Any], Any], str]] = {
        f"panorama {width}x{width // 2} to a view of 90 degrees": (
            False, flat,
            lambda photo: py360convert.e2p(photo, 90, 0, 0, (width // 2, width // 2), mode="bilinear"),
            flat_v360,
        ),
        f"the same to a cube map of {face}²": (
            False, cube,
            lambda photo: py360convert.e2c(photo, face, mode="bilinear", cube_format="dice"),
            f"input=e:output=c3x2:w={3 * face}:h={2 * face}",
        ),
        "a cube map to the panorama": (
            True, (*panorama, "--size", f"{width}x{width // 2}"),
            lambda photo: py360convert.c2e(
                np.hstack(np.vsplit(photo, 2)), width // 2, width, mode="bilinear", cube_format="horizon"
            ),
            f"input=c3x2:output=e:w={width}:h={width // 2}",
        ),
    }  # fmt: skip
    with TemporaryDirectory() as name:
        folder = Path(name)
        for title, (is_cube, options, convert, graph) in ways.items():
            photos = folder / ("cubes" if is_cube else "panoramas")
            size = (3 * face, 2 * face) if is_cube else (width, width // 2)
            files = list(write_photos(photos, size, 2 if quick else 12))
            measured = {
                "ours": partial(by_command, photos, folder / "ours", options),
                "py360convert": partial(by_function, files, folder / "py360", convert),
                "ffmpeg v360": partial(by_v360, files, folder / "v360", f"{graph}:interp=linear"),
            }
            best = {}
            for way, once in measured.items():
                best[way] = min(seconds_of(once) for _ in range(1 if quick else 3)) / len(files)
            for way in ("py360convert", "ffmpeg v360"):
                yield Figure(TABLE, title, "ms", 1e3 * best["ours"], Reference(way, 1e3 * best[way]))


def write_photos(folder: Path, size: tuple[int, int], count: int) -> Iterator[Path]:
    """Write smooth pictures, and yield their paths."""
    folder.mkdir(exist_ok=True)
    noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), np.uint8)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 0, 255, cv2.NORM_MINMAX)
    for number in range(count):
        path = folder / f"{number:02}.jpg"
        cv2.imwrite(str(path), np.roll(smooth, 37 * number, axis=1), [cv2.IMWRITE_JPEG_QUALITY, 95])
        yield path


def seconds_of(once: Callable[[], None]) -> float:
    """Return the CPU seconds of a call."""
    started = time.process_time()
    once()
    return time.process_time() - started


def by_command(photos: Path, out: Path, options: tuple[str, ...]) -> None:
    """Run ``omniscv reproject``, in this process."""
    shutil.rmtree(out, ignore_errors=True)
    command = ["reproject", str(photos), str(out), *options, "--progress", "none"]
    if run(command):
        raise RuntimeError(f"expected pictures of {' '.join(command)}")


def by_function(files: list[Path], out: Path, convert: Callable[[Any], Any]) -> None:
    """Read, convert and write files by a function of arrays."""
    out.mkdir(exist_ok=True)
    for file in files:
        cv2.imwrite(str(out / file.name), np.clip(convert(cv2.imread(str(file))), 0, 255).astype(np.uint8))


def by_v360(files: list[Path], out: Path, options: str) -> None:
    """Read, convert and write files by ffmpeg's libraries, with one graph."""
    out.mkdir(exist_ok=True)
    graph = None
    for file in files:
        with av.open(str(file)) as opened:
            frame = next(opened.decode(video=0))
        if graph is None:
            graph = av.filter.Graph()
            format_of = {"width": frame.width, "height": frame.height, "format": frame.format.name}
            source = graph.add_buffer(**format_of, time_base=Fraction(1, 25))
            filtered = graph.add("v360", options)
            sink = graph.add("buffersink")
            source.link_to(filtered)
            filtered.link_to(sink)
            graph.configure()
        frame.pts = None
        graph.push(frame)
        made = graph.pull()
        with av.open(str(out / file.name), "w", format="mjpeg") as written:
            stream = written.add_stream("mjpeg", rate=25)
            stream.width = made.width
            stream.height = made.height
            stream.pix_fmt = "yuvj420p"
            stream.codec_context.options = {"qmin": "2", "qmax": "2"}
            made = made.reformat(format=stream.pix_fmt)
            made.pts = 0
            for packet in (*stream.encode(made), *stream.encode(None)):
                written.mux(packet)
