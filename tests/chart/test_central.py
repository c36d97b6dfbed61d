"""The chart of one panorama: filters and other programs are measured on the same faces."""

import numpy as np
import pytest

from omniscv.chart import central


@pytest.fixture(scope="module")
def rows():
    return central.measure(width=64)


def test_ours_and_the_peers_are_measured(rows):
    ours = {(row.name, row.face_size) for row in rows if row.ours and row.map == "kept"}
    assert ours == {(filter, size) for filter in central.FILTERS for size in (8, 16, 32)}
    peers = {row.name for row in rows if not row.ours}
    assert peers == {"the paper's algorithm", "py360convert", "ffmpeg v360", "cv2.remap, map ready"}
    assert [row.face_size for row in rows if row.default] == [16, 16]  # its map kept, and new


def test_the_papers_algorithm_is_our_nearest_filter(rows):
    """The same faces and rays, computed apart: the same error."""
    (paper,) = (row for row in rows if row.name == "the paper's algorithm")
    (nearest,) = (row for row in rows if (row.name, row.face_size) == ("nearest", 16))
    assert nearest.rms == pytest.approx(paper.rms, rel=1e-3)  # rays on the border between two pixels


def test_ffmpeg_gets_the_faces_the_right_way_up(rows):
    """Its bilinear image differs from ours by its fixed-point weights."""
    (ffmpeg,) = (row for row in rows if row.name == "ffmpeg v360")
    (bilinear, _) = (row for row in rows if (row.name, row.face_size) == ("bilinear", 16))
    assert ffmpeg.rms == pytest.approx(bilinear.rms, rel=0.05)


def row(name, face_size, ms, rms, **more):
    values = {"map": "kept", "ours": name in central.FILTERS, "default": name == "bilinear", **more}
    return central.Row(name, 64, face_size, ms=ms, rms=rms, **values)


def test_the_title_names_sizes_speed_truth_and_front():
    ours = [row("nearest", 16, 1, 5), row("bilinear", 16, 2, 3), row("area", 16, 4, 3.5)]
    slower, limit = row("ffmpeg v360", 16, 8, 3.01), row("cv2.remap, map ready", 16, 0.5, np.nan)
    start = "6 x 16\u00b2 to 64 x 32 px, bilinear: 2.0 ms, 4.0 times as fast as ffmpeg v360"
    title = central.finding([*ours, slower, limit])
    assert title == f"{start}; none of them is nearer to the truth. Front: nearest 16, bilinear 16"
    title = central.finding([*ours, slower, row("py360convert", 16, 1.5, 2.97)])
    nearer = "py360convert is nearer to the truth by 1.0%. Front: nearest 16, py360convert"
    assert title == f"{start}; {nearer}"
