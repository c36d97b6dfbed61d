"""What docs/threads.md promises of each kind of object: threads, fork, and pickling for a spawned process."""

import contextlib
import multiprocessing
import pickle
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.faces import face_requests
from support.processes import sent_by_child

import mock_server
import omniscv
from omniscv import modalities
from omniscv.errors import SourceError
from omniscv.sources.registry import open_sources

TIMEOUT_S = 60
CAMERA = omniscv.cameras.create("noncentral-panorama", width=24, height=12, radius=0.4)
POSE = omniscv.Pose.from_angles((0.1, 0.0, 1.5), yaw_deg=30)
REQUESTS = face_requests(16, ("lit", "depth"), center=POSE.position)
OPTIONS = omniscv.RenderOptions("cube", viewpoints=1, face_size=16)

PLAIN = ("camera", "pose", "request", "options", "modality", "scene", "image")
SOURCES = ("scene source", "recording", "recorder", "live", "pool", "live pool")
RENDERERS = ("renderer of a scene", "renderer of a recording", "renderer of a server")
LIVE = ("live", "live pool", "renderer of a server")
CANNOT_BE_PICKLED = (*LIVE, "recorder", "pool")

pytestmark = pytest.mark.usefixtures("all_cores")


def digest(*arrays):
    return zlib.crc32(b"".join(np.ascontiguousarray(each).tobytes() for each in arrays))


def work(thing):
    """A number that depends on all that the object does."""
    if isinstance(thing, omniscv.cameras.Camera):
        rays = thing.unproject()
        return digest(rays.directions, thing.project(rays.directions * 2 + rays.origins)[0])
    if isinstance(thing, mock_server.Scene):
        return digest(thing.trace(POSE.position, CAMERA.unproject().directions).distance)
    if isinstance(thing, omniscv.sources.Source):
        pixels = [capture.pixels for capture in thing.capture(REQUESTS)]
        return digest(*pixels), thing.objects().names()
    if isinstance(thing, omniscv.Renderer):
        image = thing.render(CAMERA, POSE, ("lit", "depth"), OPTIONS)
        return digest(image.lit, image.depth)
    if isinstance(thing, omniscv.OmniImage):
        return digest(thing.lit, thing.points())
    return repr(thing)


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    """One of each, opened and used once."""
    with contextlib.ExitStack() as held:
        path = tmp_path_factory.mktemp("sharing") / "room.sqlite"
        opened = {
            "scene source": omniscv.open_source("scene://four-wall"),
            "live": omniscv.open_source("mock://four-wall"),
            "recorder": omniscv.record(omniscv.open_source("scene://four-wall"), path),
            "pool": open_sources(["scene://four-wall", "scene://four-wall"]),
            "live pool": open_sources(["mock://four-wall", "mock://four-wall"]),
        }
        image = omniscv.Renderer(opened["recorder"]).render(CAMERA, POSE, ("lit", "depth"), OPTIONS)
        list(opened["recorder"].capture(REQUESTS))
        opened["recorder"].objects()
        opened["recording"] = omniscv.open_source(path)
        for source in opened.values():
            held.enter_context(source)
        yield {
            "camera": CAMERA,
            "pose": POSE,
            "request": REQUESTS[0],
            "options": OPTIONS,
            "modality": modalities.get("depth"),
            "scene": mock_server.load_scene("four-wall"),
            "image": image,
            **opened,
            "renderer of a scene": omniscv.Renderer(opened["scene source"]),
            "renderer of a recording": omniscv.Renderer(opened["recording"]),
            "renderer of a server": omniscv.Renderer(opened["live"]),
        }


def test_every_kind_is_here(things):
    assert set(things) == {*PLAIN, *SOURCES, *RENDERERS}


@pytest.mark.parametrize("name", [*PLAIN, *SOURCES, *RENDERERS])
def test_threads(name, things):
    expected = work(things[name])
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(work, [things[name]] * 4)) == [expected] * 4


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("name", ["camera", "scene", "image", *SOURCES, *RENDERERS])
def test_fork(name, things):
    """While another thread of the parent uses the object, so that its locks may be taken at the fork.

    Of plain objects, those that compute or hold arrays; the others are only values.
    """
    expected = work(things[name])
    with ThreadPoolExecutor(1) as thread:
        busy = thread.submit(lambda: [work(things[name]) for _ in range(2)])
        sent = sent_by_child("fork", _send_work, things[name])
        assert busy.result(TIMEOUT_S) == [expected] * 2
    if name in LIVE:
        assert "expected to be used by the process that opened it" in sent
        assert "open it again there" in sent
    else:
        assert sent == expected
    assert work(things[name]) == expected  # a child that closes its copy closes nothing of the parent


def _send_work(pipe, thing):
    try:
        found = work(thing)
    except SourceError as error:
        found = str(error)
    if isinstance(thing, omniscv.sources.Source):
        thing.close()
    pipe.send(found)


def test_spawn(things):
    """One process for all of them: starting it is what takes time."""
    names = [name for name in things if name not in CANNOT_BE_PICKLED]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map_async(work, [things[name] for name in names]).get(TIMEOUT_S)
    assert dict(zip(names, found, strict=True)) == {name: work(things[name]) for name in names}


@pytest.mark.parametrize("name", CANNOT_BE_PICKLED)
def test_what_cannot_be_pickled_says_so(name, things):
    with pytest.raises(SourceError, match=r"expected a source that can be pickled.*open it in each process"):
        pickle.dumps(things[name])
