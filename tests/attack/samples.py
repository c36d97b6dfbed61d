"""What attacks start from: one right recording, its folder and its images, made once a process."""

import atexit
import shutil
import sqlite3
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from support.faces import face_requests

import mock_server
import omniscv
from attack.commands import ran, require

MODES = ("lit", "object_mask", "depth")
SIZE = 16
JOB = """
source: {source}
cameras: {{pano: {{model: equirectangular, width: 16, height: 8}}}}
poses: [{{position: [0, 0, 1.5]}}]
modes: [lit, object_mask, depth]
strategy: cube
face_size: 16
out: images
source_options: {{timeout_s: 0.4, patience_s: 2, retries: 1}}
"""


def requests():
    return face_requests(SIZE, MODES)


_held = ExitStack()
atexit.register(_held.close)


@dataclass(frozen=True)
class Sample:
    """A recording made through the mock server, and what replays it."""

    recording: Path  # closed, without a log
    folder: Path  # exported from it
    images: dict  # file name to bytes, of JOB rendered from the mock server
    captures: tuple
    objects: object


@cache
def server():
    return _held.enter_context(mock_server.serve("four-wall", port=0, size=(SIZE, SIZE)))


@cache
def sample():
    home = Path(tempfile.mkdtemp(prefix="attack-sample-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    recording = home / "room.sqlite"
    with omniscv.open_source(server().uri) as live, omniscv.record(live, recording) as source:
        list(source.capture(requests()))
        source.objects()
    with sqlite3.connect(recording) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    captures, objects = contents(recording)
    exported = ran(["recording", "export", str(recording), str(home / "faces")])
    require(exported.code == 0, "no export of the sample")
    (home / "job.yaml").write_text(JOB.format(source=server().uri))
    require(ran(["render", str(home / "job.yaml")]).code == 0, "no images of the sample")
    return Sample(recording, home / "faces", pictures(home / "images"), captures, objects)


def contents(recording):
    """The captures of all requests, and the objects; raises an OmniscvError where one is refused."""
    with omniscv.open_source(recording) as source:
        return tuple(source.capture(requests())), source.objects()


def pictures(folder):
    """The image files of a folder; what describes them names the server."""
    return {each.name: each.read_bytes() for each in folder.iterdir() if each.suffix in (".png", ".exr")}


def same(captures, objects):
    """Whether captures and objects are those of the sample: pixels, views, colours."""

    def told(each):
        return each.request, each.view, each.pixels.dtype, each.pixels.tobytes()

    true = sample()
    return objects == true.objects and [*map(told, captures)] == [*map(told, true.captures)]
