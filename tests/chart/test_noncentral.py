"""The chart of non-central cameras: every strategy is measured, and what it counts is what was captured."""

import json
from dataclasses import replace

import pytest
from PIL import Image

from omniscv.chart import noncentral


@pytest.fixture(scope="module")
def rows():
    return noncentral.measure(width=32, face_size=16)


def test_every_way_is_measured(rows):
    assert {(r.camera, r.strategy, r.viewpoints) for r in rows} == {
        (camera, *way) for camera in noncentral.cameras(32) for way in noncentral.WAYS
    }
    assert sum(r.default for r in rows) == 3


def test_cube_takes_six_views_a_centre_and_the_others_less(rows):
    for name, camera in noncentral.cameras(32).items():
        mine = {(r.strategy, r.viewpoints): r for r in rows if r.camera == name}
        cube = mine["cube", None]
        faces = 6 * len(camera.viewpoints().centers)
        around = 6  # at the camera's position, in depth alone, to find which viewpoints are occluded
        assert cube.views == faces + around
        assert cube.requests == 3 * faces + around
        assert mine["faces", None].views < cube.views
        assert mine["faces", None].wrong == cube.wrong  # the same faces, less those that no ray hits
        assert mine["strips", None].megapixels < 0.9 * mine["faces", None].megapixels
        assert mine["adaptive", 2].views < 0.4 * cube.views
        assert cube.seconds[30] - cube.seconds[5] == pytest.approx(0.025 * cube.requests)


def test_it_is_written_and_drawn(rows, tmp_path):
    data, drawn, picture = noncentral.write(rows, tmp_path)
    found = json.loads(data.read_text())
    assert [row["seconds"]["30"] for row in found] == [row.seconds[30] for row in rows]
    assert [row["wrong"] for row in found] == [row.wrong for row in rows]
    with Image.open(picture) as opened:
        assert opened.width == 1600
    assert all(name in drawn.read_text() for name in ("panorama", "ball", "cone", "the paper"))


def test_the_title_counts_the_requests_of_what_is_as_true(rows):
    """Half of the paper's requests with fewer wrong pixels count; a tenth with more of them do not."""
    paper = next(row for row in rows if row.strategy == noncentral.PAPER and row.camera == "ball")
    half = replace(paper, strategy="strips", requests=paper.requests // 2, wrong=0.9 * paper.wrong)
    tenth = replace(half, requests=paper.requests // 10, wrong=1.1 * paper.wrong)
    assert "with 2 to 2 times fewer" in noncentral.finding([paper, half, tenth])
