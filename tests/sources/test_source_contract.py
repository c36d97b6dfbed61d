"""The laws of every source, live or not, alone or wrapped."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from support import blender
from support.faces import CENTER, face_requests
from support.recordings import filled

import omniscv
from omniscv.errors import SourceError
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, SourceWrapper, View
from omniscv.sources.registry import open_sources
from omniscv.testing import check_source

SIZE = 12
OLD = f"mock://four-wall?dialect=0.3.10&size={SIZE}x{SIZE}"
ELSEWHERE = (0.5, -0.25, 1.25)
MODES = ("lit", "object_mask", "depth", "normals")
REQUESTS = [*face_requests(SIZE, MODES), *face_requests(SIZE, ("lit", "depth"), ELSEWHERE)]


def opened(uri):
    return lambda path: omniscv.open_source(uri)


@cache
def half():
    with TemporaryDirectory() as folder:
        return filled(Path(folder) / "room.sqlite", REQUESTS[::2]).read_bytes()


@cache
def whole(uri):
    with TemporaryDirectory() as folder:
        path = Path(folder) / "room.sqlite"
        with omniscv.record(omniscv.open_source(uri), path) as recording:
            recording.objects()
            views = {view for request in REQUESTS for view in recording.cover(request.view)}
            list(recording.capture(Request(view, mode) for view in views for mode in MODES))
        return path.read_bytes()


def recording(path):
    path.write_bytes(half())
    return omniscv.record(omniscv.open_source("scene://four-wall"), path)


def replayed(uri):
    def source(path):
        path.write_bytes(whole(uri))
        return omniscv.open_source(path)

    return source


SOURCES = {
    "mock N3": opened("mock://four-wall"),
    "mock 0.3.10": opened(OLD),
    "scene": opened("scene://four-wall"),
    "wrapper": lambda path: SourceWrapper(omniscv.open_source("scene://four-wall?masks=ids&lit=float32")),
    "recording": recording,
    "replay": replayed("scene://four-wall?masks=ids&lit=float32"),
    "replay of 0.3.10": replayed(OLD),
    "pool": lambda path: open_sources(["mock://four-wall", "mock://four-wall"]),
}
if (mujoco := find_spec("mujoco")) and mujoco.origin:  # not the folder of its tests
    ROOM = Path(__file__).parent / "mujoco" / "four-wall.xml"
    SOURCES["mujoco"] = lambda path: omniscv.open_source(f"mujoco://{ROOM}")
if find_spec("embreex"):
    from support.meshes import write_room

    def mesh(path):
        write_room(path.with_name("four-wall.glb"))
        return omniscv.open_source(f"mesh://{path.with_name('four-wall.glb')}")

    SOURCES["mesh"] = mesh
if blender.found():
    SOURCES["blender"] = lambda path: omniscv.open_source(blender.address("four-wall"))


@pytest.fixture(params=SOURCES, scope="module")
def source(request, tmp_path_factory):
    with SOURCES[request.param](tmp_path_factory.mktemp("shared") / "room.sqlite") as source:
        yield source


@pytest.fixture(params=SOURCES)
def own_source(request, tmp_path):
    with SOURCES[request.param](tmp_path / "room.sqlite") as source:
        yield source


def test_contract(source):
    check_source(source)


def test_masks_have_colours_of_objects_a_scene_its_name_and_a_view_its_cover(source):
    table = source.objects()
    for capture in source.capture(request for request in REQUESTS if request.mode == "object_mask"):
        assert capture.provenance["scene"] == "four-wall"
        if not table.ids:
            colors = np.array(list(table.colors.values()))
            off = np.abs(capture.pixels.reshape(-1, 1, 3).astype(int) - colors).max(axis=2).min(axis=1)
            assert off.max() <= table.tolerance
    for _, R_w_c in cube_rotations():
        view = View(Pose(CENTER, R_w_c), 90.0, SIZE, SIZE)
        cover = source.cover(view)
        assert cover[0] == view
        assert len(list(source.capture(Request(each, "lit") for each in cover))) == len(cover)


def test_several_threads_may_use_it(source):
    def pixels_of(part):
        return [capture.pixels for capture in source.capture(part)]

    parts = [REQUESTS[start::18] for start in range(4)]
    alone = [pixels_of(part) for part in parts]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(pixels_of, parts))
    for one, other in zip(alone, together, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_recorded_and_replayed_it_is_the_same(own_source, tmp_path):
    """Whatever its bytes: views, pixels to the bit, provenance, objects, and the views that cover another.

    It is closed with the recorder, and raises one clear sentence then.
    """
    views = tuple(dict.fromkeys(request.view for request in REQUESTS[::3]))
    with omniscv.record(own_source, tmp_path / "new.sqlite") as recording:
        objects = recording.objects()
        covers = [recording.cover(view) for view in views]
        shapes = recording.geometry().to_dict()
        requests = [Request(view, mode) for mode in MODES for cover in covers for view in cover]
        captured = list(recording.capture(requests))
    with omniscv.open_source(tmp_path / "new.sqlite") as replay:
        assert replay.objects() == objects
        assert replay.geometry().to_dict() == shapes
        assert [replay.cover(view) for view in views] == covers
        assert replay.capabilities.modes == set(MODES)
        assert set(replay.recorded_views()) == {request.view for request in requests}
        for capture, again in zip(captured, replay.capture(requests), strict=True):
            assert again.view == capture.view
            assert again.pixels.dtype == capture.pixels.dtype
            assert np.array_equal(again.pixels, capture.pixels)
            assert again.provenance == capture.provenance
    for use in (lambda: list(own_source.capture(REQUESTS[:1])), own_source.objects, own_source.geometry):
        with pytest.raises(SourceError, match="expected an open source, got a closed one; open it again"):
            use()
