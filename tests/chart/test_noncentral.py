"""The chart of non-central cameras: every strategy is measured, and what it counts is what was captured."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from omniscv.chart import noncentral


@pytest.fixture(scope="module")
def rows():
    return noncentral.measure(width=48, face_size=32)


def test_every_way_is_measured(rows):
    assert {(r.camera, r.strategy, r.viewpoints) for r in rows} == {
        (camera, *way) for camera in noncentral.cameras(48) for way in noncentral.WAYS
    }
    assert sum(r.default for r in rows) == 3


def test_cube_takes_six_views_a_centre_and_the_others_less(rows):
    for name, camera in noncentral.cameras(48).items():
        mine = {(r.strategy, r.viewpoints): r for r in rows if r.camera == name}
        cube = mine["cube", None]
        faces = 6 * len(camera.viewpoints().centers)
        around = 6  # at the camera's position, in depth alone, to find which viewpoints are occluded
        assert cube.views == faces + around
        assert cube.requests == 3 * faces + around
        assert mine["faces", None].views < cube.views
        assert mine["faces", None].wrong == cube.wrong  # the same faces, less those that no ray hits
        assert mine["strips", None].megapixels < 0.6 * mine["faces", None].megapixels
        assert mine["adaptive", 2].views < 0.3 * cube.views
        assert cube.seconds[30] - cube.seconds[0] == pytest.approx(0.03 * cube.requests)


def test_it_writes_json_and_a_picture_of_a_line_a_camera(rows, tmp_path):
    two, one = ([r for r in rows if r.camera in some] for some in (("cone", "ball"), ("cone",)))
    data, picture = noncentral.write(two, tmp_path)
    found = json.loads(data.read_text())
    assert [row["seconds"]["30"] for row in found] == [row.seconds[30] for row in two]
    assert [row["wrong"] for row in found] == [row.wrong for row in two]
    _, shorter = noncentral.write(one, tmp_path / "shorter")
    _, moved = noncentral.write([*one[:-1], replace(one[-1], wrong=0.5)], tmp_path / "moved")
    both, cone, other = (np.array(Image.open(path)) for path in (picture, shorter, moved))
    assert cone.shape[0] == pytest.approx(both.shape[0] / 2, abs=2)
    assert np.any(cone != other)
