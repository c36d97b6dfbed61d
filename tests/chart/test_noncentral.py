"""The chart of non-central cameras: every strategy is measured, and what it counts is what was captured."""

import json

import cv2
import pytest

from omniscv.chart import noncentral


@pytest.fixture(scope="module")
def rows():
    return noncentral.measure(width=64)


def test_every_way_is_measured(rows):
    assert {(r.camera, r.strategy, r.viewpoints) for r in rows} == {
        (camera, *way) for camera in noncentral.cameras(64) for way in noncentral.WAYS
    }
    assert sum(r.default for r in rows) == 3


def test_cube_takes_six_views_a_centre_and_the_others_less(rows):
    for name, camera in noncentral.cameras(64).items():
        mine = {(r.strategy, r.viewpoints): r for r in rows if r.camera == name}
        cube = mine["cube", None]
        assert cube.views == 6 * len(camera.viewpoints().centers) + 6  # six that look around
        assert cube.requests == 3 * cube.views
        assert mine["faces", None].views < cube.views
        assert mine["faces", None].wrong == cube.wrong  # the same faces, less those that no ray hits
        assert mine["strips", None].megapixels < 0.6 * mine["faces", None].megapixels
        assert mine["adaptive", 2].views < 0.3 * cube.views
        assert cube.seconds[30] - cube.seconds[0] == pytest.approx(0.03 * cube.requests)


def test_it_writes_json_and_a_picture(rows, tmp_path):
    data, picture = noncentral.write(rows, tmp_path)
    assert len(json.loads(data.read_text())) == len(rows)
    assert min(cv2.imread(str(picture)).shape[:2]) > 300
