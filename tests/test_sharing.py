"""Work on all cores, and what docs/threads.md promises of each kind of object: threads, fork, pickling."""

import contextlib
import multiprocessing
import os
import pickle
import sys
import threading
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
from omniscv.parallel import MIN_PARALLEL_ELEMENTS, ahead, blocks, cores, limit, side_by_side
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
        pixels = thing.project(rays.directions * 2 + rays.origins)[0]
        return digest(rays.directions, np.round(pixels, 9))  # NumPy 2.0: the last digit varies
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


@pytest.mark.parametrize("name", [*PLAIN, *SOURCES, *RENDERERS])
def test_threads(name, things):
    assert set(things) == {*PLAIN, *SOURCES, *RENDERERS}
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
    names = [name for name in things if name not in CANNOT_BE_PICKLED]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map_async(work, [things[name] for name in names]).get(TIMEOUT_S)
    assert dict(zip(names, found, strict=True)) == {name: work(things[name]) for name in names}


@pytest.mark.parametrize("name", CANNOT_BE_PICKLED)
def test_what_cannot_be_pickled_says_so(name, things):
    with pytest.raises(SourceError, match=r"expected a source that can be pickled.*open it in each process"):
        pickle.dumps(things[name])


def squares(count=40):
    return side_by_side(lambda n: n * n, range(count))


def resample():
    import cv2

    image = np.arange(300 * 300, dtype=np.float32).reshape(300, 300)
    v, u = np.indices(image.shape, dtype=np.float32)
    parts = blocks(lambda rows: cv2.remap(image, u[rows], v[rows], cv2.INTER_LINEAR), 300, 1 << 20)
    return np.array_equal(np.concatenate(parts), image)


def all_well():
    return squares() == [n * n for n in range(40)] and resample()


def test_what_was_begun_is_finished_if_the_next_item_cannot_be_had():
    def items():
        yield from range(3)
        raise ValueError("no more")

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # the failure often comes before the last item's thread
    try:
        for _ in range(1500):
            done = list[int]()
            with pytest.raises(ValueError, match="no more"):
                list(ahead(done.append, items(), 1))
            assert done == [0, 1, 2]
    finally:
        sys.setswitchinterval(interval)


def test_cores_can_be_limited():
    every = cores()
    here = threading.get_ident()
    try:
        limit(1)
        assert cores() == 1
        assert set(side_by_side(lambda _: threading.get_ident(), range(20))) == {here}
        limit(every + 1)
        assert cores() == every
    finally:
        limit(every)


@pytest.mark.parametrize("elements", [None, MIN_PARALLEL_ELEMENTS, 10 * MIN_PARALLEL_ELEMENTS])
@pytest.mark.parametrize("count", [0, 1, 7, 1000])
def test_results_come_in_order_and_blocks_cover_all_rows(count, elements):
    assert squares(count) == [n * n for n in range(count)]
    rows = blocks(lambda part: list(range(count))[part], count, elements)
    assert [row for part in rows for row in part] == list(range(count))
    assert len(rows) == (max(1, min(count, 4 * cores())) if elements and cores() > 1 else 1)


def test_the_first_error_is_raised_and_the_rest_is_not_started():
    called = []

    def function(number):
        called.append(number)
        if number in (3, 4):
            raise ValueError(f"no {number}")
        return number

    with pytest.raises(ValueError, match="no 3"):
        side_by_side(function, range(1000))
    assert len(called) < 10 * max(2, cores())
    assert all_well()


def test_it_can_be_nested():
    def in_a_thread(number):
        with ThreadPoolExecutor(1) as thread:
            return sum(thread.submit(squares, number).result())

    def outer(number):
        return sum(side_by_side(in_a_thread, range(number)))

    expected = [sum(sum(i * i for i in range(n)) for n in range(m)) for m in range(12)]
    assert side_by_side(outer, range(12)) == expected


def test_several_threads_may_use_it():
    with ThreadPoolExecutor(6) as threads:
        assert all(threads.map(lambda _: all_well(), range(6)))


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.soak)])
def test_it_works_in_child_processes_after_use_in_the_parent(method):
    """As PyTorch's DataLoader forks its workers; also while another thread of the parent is at work."""
    assert all_well()
    stop = threading.Event()

    def work():
        while not stop.is_set():
            all_well()

    busy = threading.Thread(target=work)
    busy.start()
    try:
        assert all(sent_by_child(method, _send_all_well) for _ in range(2))
    finally:
        stop.set()
        busy.join()


def _send_all_well(pipe):
    pipe.send(all_well() and os.getpid() > 0)
