"""Growth: memory, descriptors and threads of a process that works for long are level."""

import gc

import psutil
import pytest
from support.faces import face_requests

import omniscv
from omniscv import RenderOptions, cameras

CAMERA = cameras.create("equirectangular", 32, 16)
MODES = ("lit", "object_mask", "depth")
MOST_GROWTH_BYTES = 24 << 20  # what allocators keep; 20,000 captures of 8 x 8 px in a list are more


def centers(count):
    return [(0.001 * i - 1, 0.3, 1.5) for i in range(count)]


def rendered(folder, count):
    """Images at new places, of one source and one renderer."""
    with omniscv.open_source("scene://four-wall") as source:
        renderer, options = omniscv.Renderer(source), RenderOptions(face_size=16)
        for position in centers(count):
            renderer.render(CAMERA, omniscv.Pose.from_angles(position), MODES, options)


def captured(folder, count):
    """Captures of a server, over one connection."""
    requests = (each for center in centers(count // 6) for each in face_requests(8, ("lit",), center))
    with omniscv.open_source("mock://four-wall") as source:
        for _ in source.capture(requests):
            pass


def reopened(folder, count):
    """Servers, and a recording that each of them adds to."""
    path = folder / f"{len(list(folder.iterdir()))}.sqlite"
    for position in centers(count):
        with omniscv.record(omniscv.open_source("mock://four-wall"), path) as source:
            omniscv.render(CAMERA, omniscv.Pose.from_angles(position), source, MODES, face_size=16)
        with omniscv.open_source(path) as source:
            omniscv.render(CAMERA, omniscv.Pose.from_angles(position), source, MODES, face_size=16)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("work", "count"), [(rendered, 2000), (captured, 20_000), (reopened, 30)])
def test_what_a_process_holds_is_level(work, count, tmp_path):
    work(tmp_path, count // 3)  # fills caches
    process, held = psutil.Process(), []
    for _ in range(2):
        gc.collect()
        held.append((process.memory_info().rss, process.num_fds(), process.num_threads()))
        work(tmp_path, count)
    gc.collect()
    assert process.num_fds() == held[0][1]
    assert process.num_threads() <= held[1][2]
    assert process.memory_info().rss - held[1][0] < MOST_GROWTH_BYTES
