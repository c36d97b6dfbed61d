"""Files by the writers of others show where their surfaces are, whose they are, and in which colours."""

import numpy as np
import pytest
from support.mesh_files import BLUE, FORMS, GREEN, RED, WHITE

import omniscv

CENTER_W = np.array([0.0, 0.1, 0.45])
PLACES = np.array([
    [-2, -0.3, 0.2], [-2, 0.3, 0.2], [-2, -0.3, 0.8], [-2, 0.3, 0.8],
    [2, -0.3, 0.2], [2, 0.3, 0.2], [2, -0.3, 0.8], [2, 0.3, 0.8],
    [2, 0.6, 0.5], [-2, 0.0, 1.1],
])  # fmt: skip
"""Points on both squares, and two beside them, world frame."""
COLORS = np.array([RED, RED, GREEN, GREEN, BLUE, BLUE, BLUE, WHITE, (0, 0, 0), (0, 0, 0)]) / 255
LABELS = np.array([1] * 4 + [2] * 4 + [0] * 2)
QUANTIZED_M = 1e-4
"""Half a step of 16 bits over 4 m, and of Draco's 20 bits, seen along a ray."""


@pytest.fixture(params=FORMS)
def form(request):
    return request.param


def opened(form, folder, query=""):
    name, write = FORMS[form]
    write(folder / name)
    return omniscv.open_source(f"mesh://{folder / name}{query}")


def rays():
    toward = PLACES - CENTER_W
    lengths = np.linalg.norm(toward, axis=1)
    return toward / lengths[:, None], np.where(LABELS > 0, lengths, np.inf)


def test_surfaces_stand_where_the_writer_put_them(form, tmp_path):
    toward, lengths = rays()
    with opened(form, tmp_path) as source:
        hits = source.trace(CENTER_W, toward)
    np.testing.assert_allclose(hits.distance, lengths, atol=QUANTIZED_M)
    assert (hits.label > 0).tolist() == (LABELS > 0).tolist()


def test_objects_have_the_names_of_the_file(form, tmp_path):
    toward, _ = rays()
    with opened(form, tmp_path) as source:
        names = source.objects().names()
        label = source.trace(CENTER_W, toward).label
    if form in ("stl", "off"):
        assert names == ["mesh"]
        return
    expected = ["object_12", "object_7"] if form.startswith("ply") else ["Left", "Right"]
    assert names == expected
    left_first = LABELS if names[0] == "Left" else np.array([0, 2, 1])[LABELS]
    np.testing.assert_array_equal(label, left_first)


def test_pictures_lie_on_surfaces_as_the_file_says(form, tmp_path):
    toward, _ = rays()
    with opened(form, tmp_path) as source:
        colors = source.shade(CENTER_W, toward)
    if form in ("stl", "off"):
        np.testing.assert_array_equal(colors, np.where(LABELS[:, None] > 0, 1.0, 0.0).repeat(3, axis=1))
    elif form.startswith("ply"):
        strongest = colors[:8].argmax(axis=1)
        assert strongest[:6].tolist() == [0, 0, 1, 1, 2, 2]
        assert colors[7].min() > colors[6].min()  # nearer to the white corner
    else:
        np.testing.assert_allclose(colors, COLORS, atol=0.002)  # of places in 16 bits


def test_materials_are_objects_where_that_is_asked_for(form, tmp_path):
    with opened(form, tmp_path, "?labels=material") as source:
        names = source.objects().names()
    with_materials = form == "obj" or form.startswith("gl")
    assert names == (["paint_Left", "paint_Right"] if with_materials else ["mesh"])


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("ft", 0.3048)])
def test_units_and_the_axis_that_points_up_can_be_given(unit, metres, tmp_path):
    with opened("ply doubles", tmp_path, f"?unit={unit}&up=y") as source:
        box = source.geometry().boxes["object_7"]
    # The file's z, 0 to 1, is then minus the world's y, and its y is the world's z.
    np.testing.assert_allclose(box.center_w, np.array([-2, -0.5, 0]) * metres, atol=1e-12)
    np.testing.assert_allclose(box.size, np.array([0, 1, 1]) * metres, atol=1e-12)


def test_doubles_are_kept(tmp_path):
    """A millionth of a metre at 2 m is less than half a digit of float32 at a coordinate of a map."""
    from support import mesh_files

    path = tmp_path / "map.ply"
    mesh_files.ply(path, double=True)
    data = path.read_bytes()
    header, _, rows = data.partition(b"end_header\n")
    size = 8 * np.dtype([("p", "f8", 3), ("c", "u1", 3)]).itemsize
    table = np.frombuffer(rows[:size], [("p", "<f8", 3), ("c", "u1", 3)]).copy()
    table["p"] += [500000.0, 4500000.0, 0]
    path.write_bytes(header + b"end_header\n" + table.tobytes() + rows[size:])
    toward, lengths = rays()
    with omniscv.open_source(f"mesh://{path}") as source:
        hits = source.trace(CENTER_W + np.array([500000.0, 4500000.0, 0]), toward)
    np.testing.assert_allclose(hits.distance, lengths, atol=2e-9)  # a digit of 4,500,000 m
