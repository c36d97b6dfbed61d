"""The chart of accuracy: every way is measured, and what it counts is what was captured."""

import json
from dataclasses import replace

import pytest
from PIL import Image

from omniscv.chart import accuracy


@pytest.fixture(scope="module")
def rows():
    return accuracy.measure(width=32, asked=(0.1,))


def by_way(rows, camera):
    return {(row.series, row.viewpoints, row.face_size): row for row in rows if row.camera == camera}


def test_the_paper_takes_six_faces_a_centre_and_the_others_less(rows):
    for name, camera in accuracy.cameras(32).items():
        mine = by_way(rows, name)
        paper = mine[accuracy.PAPER, None, 8]
        faces = 6 * len(camera.viewpoints().centers)
        around = 0 if camera.central else 6  # in depth alone, to find which viewpoints are occluded
        assert paper.requests == 2 * faces + around
        assert mine["faces", None, 8].requests <= paper.requests
        assert mine["faces", None, 8].wrong == paper.wrong  # the same faces, less those that no ray hits
        assert paper.seconds == pytest.approx(0.005 * paper.requests + 0.025 * paper.megapixels)
        assert paper.seconds_at[30] - paper.seconds == pytest.approx(0.025 * paper.requests)


def test_finer_faces_leave_less_doubt(rows):
    mine = by_way(rows, "panorama")
    doubt = [mine["faces", None, size].doubtful for size in (4, 16, 64)]
    assert doubt == sorted(doubt, reverse=True)
    assert all(row.wrong <= row.doubtful for row in rows)


def test_what_is_asked_for_is_reached(rows):
    asked = [row for row in rows if row.aim is not None]
    assert [row.camera for row in asked] == list(accuracy.cameras(32))
    assert all(row.doubtful <= row.aim == 0.1 for row in asked)


def test_it_is_written_and_drawn(rows, tmp_path):
    data, drawn, picture = accuracy.write(rows, tmp_path)
    assert [row["doubtful"] for row in json.loads(data.read_text())] == [row.doubtful for row in rows]
    with Image.open(picture) as opened:
        assert opened.width == 1600
    assert all(name in drawn.read_text() for name in ("mirror ball", "the paper", "accuracy=10 %"))


def test_the_title_counts_what_is_no_more_doubtful(rows):
    """Half of the paper's time with less doubt counts; a tenth with more doubt does not."""
    paper = next(row for row in rows if row.series == accuracy.PAPER and row.camera == "mirror ball")
    half = replace(paper, series="strips", seconds=paper.seconds / 2, doubtful=0.9 * paper.doubtful)
    tenth = replace(half, seconds=paper.seconds / 10, doubtful=1.1 * paper.doubtful)
    assert "a mirror ball 2 times cheaper" in accuracy.finding([paper, half, tenth])
