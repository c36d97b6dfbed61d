"""Work on all cores: nested, from several threads, after a fork and in spawned processes."""

import os
import sys
import threading

import numpy as np
import pytest
from support.processes import sent_by_child

from omniscv.parallel import MIN_PARALLEL_ELEMENTS, ahead, blocks, cores, limit, side_by_side

pytestmark = pytest.mark.usefixtures("all_cores")


def squares(count=40):
    return side_by_side(lambda n: n * n, range(count))


def resample():
    """What composing does: OpenCV, which has threads of its own, in parallel."""
    import cv2

    image = np.arange(300 * 300, dtype=np.float32).reshape(300, 300)
    v, u = np.indices(image.shape, dtype=np.float32)
    parts = blocks(lambda rows: cv2.remap(image, u[rows], v[rows], cv2.INTER_LINEAR), 300, 1 << 20)
    return np.array_equal(np.concatenate(parts), image)


def all_well():
    return squares() == [n * n for n in range(40)] and resample()


def test_results_come_in_order():
    assert squares() == [n * n for n in range(40)]
    assert side_by_side(str, []) == []
    assert side_by_side(str, [7]) == ["7"]


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
    every, here = cores(), threading.get_ident()
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
def test_blocks_cover_all_rows(count, elements):
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
    """In its own workers, and in a thread that they wait for."""

    def in_a_thread(number):
        found = []
        thread = threading.Thread(target=lambda: found.extend(squares(number)))
        thread.start()
        thread.join()
        return sum(found)

    def outer(number):
        return sum(side_by_side(in_a_thread, range(number)))

    expected = [sum(sum(i * i for i in range(n)) for n in range(m)) for m in range(12)]
    assert side_by_side(outer, range(12)) == expected


def test_several_threads_may_use_it():
    found = {}
    threads = [threading.Thread(target=lambda n=n: found.update({n: all_well()})) for n in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == dict.fromkeys(range(6), True)


@pytest.mark.parametrize(("method", "children"), [("fork", 2), ("spawn", 1)])
def test_it_works_in_child_processes_after_use_in_the_parent(method, children):
    """As PyTorch's DataLoader forks its workers; also while another thread of the parent is at work.

    What is spawned shares nothing with its parent: one child shows as much as many.
    """
    assert all_well()
    stop = threading.Event()

    def work():
        while not stop.is_set():
            all_well()

    busy = threading.Thread(target=work)
    busy.start()
    try:
        assert all(sent_by_child(method, _send_all_well) for _ in range(children))
    finally:
        stop.set()
        busy.join()


def _send_all_well(pipe):
    pipe.send(all_well() and os.getpid() > 0)
