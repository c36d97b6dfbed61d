"""The chart of accuracy: it measures every strategy and counts its captures."""

import pytest

from omniscv.chart import accuracy

CAMERAS = ("panorama", "mirror ball")


@pytest.fixture(scope="module")
def rows():
    """Two cameras by fewer strategies than the chart has."""
    cameras = accuracy.cameras
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accuracy, "cameras", lambda width: {name: cameras(width)[name] for name in CAMERAS})
        patch.setattr(accuracy, "_NONCENTRAL", {**accuracy._NONCENTRAL, accuracy.EXACT: [("exact", None, 1)]})
        return accuracy.measure(width=32, asked=(0.1,))


def by_way(rows, camera):
    return {(row.series, row.viewpoints, row.face_size): row for row in rows if row.camera == camera}


def test_the_paper_takes_six_faces_a_centre_and_the_others_less(rows):
    for name in CAMERAS:
        camera = accuracy.cameras(32)[name]
        mine = by_way(rows, name)
        paper = mine[accuracy.PAPER, None, 8]
        faces = 6 * len(camera.viewpoints().centers)
        around = 0 if camera.central else 6  # in depth alone, to find which viewpoints are occluded
        assert paper.requests == 2 * faces + around
        assert mine[accuracy.EXACT, None, 8].requests <= paper.requests
        assert mine[accuracy.DEFAULT, None, None].requests <= paper.requests
        assert paper.seconds == pytest.approx(0.005 * paper.requests + 0.025 * paper.megapixels)
        assert paper.seconds_at[30] - paper.seconds == pytest.approx(0.025 * paper.requests)


def test_finer_faces_leave_less_doubt(rows):
    mine = by_way(rows, "panorama")
    doubt = [mine[accuracy.EXACT, None, size].doubtful for size in (4, 16, 64)]
    assert doubt == sorted(doubt, reverse=True)
    assert all(row.wrong <= row.doubtful for row in rows)


def test_aims_are_reached(rows):
    asked = [row for row in rows if row.aim is not None]
    assert [row.camera for row in asked] == list(CAMERAS)
    assert all(row.doubtful <= row.aim == 0.1 for row in asked)
