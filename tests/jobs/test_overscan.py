"""Cube maps are recorded with an overscan, which changes no image of a game without faults."""

import numpy as np
import pytest

import omniscv
from omniscv.cli import run
from omniscv.sources.recording.inspection import info

EDGE = 64
PLACE = (0.3, 0.2, 1.4)
MODES = ("lit", "object_mask", "depth", "normals")
CAMERAS = {
    "equirectangular": {"width": 96, "height": 48},
    "fisheye-equidistant": {"width": 64, "height": 64, "fov_deg": 190},
}


def record(out, *options, source="mock://four-wall", edge=EDGE):
    """Record the faces of a place; return the number of captures by size."""
    base = ["record", "--source", source, "--set", f"face_size={edge}", "--modes", "lit,mask,depth,normals"]
    place = ",".join(map(str, PLACE))
    assert run([*base, "--position", place, "--out", str(out), *options]) == 0
    return info(out).sizes


@pytest.mark.parametrize("filter_", ["nearest", "bilinear", "bicubic", "area"])
def test_overscan_changes_no_image(filter_, both):
    """Pixels coincide but for the last digit of the field of view, which decides at outlines of textures."""
    name = "fisheye-equidistant" if filter_ == "area" else "equirectangular"
    camera = omniscv.cameras.create(name, **CAMERAS[name])
    pose = omniscv.Pose.from_angles(PLACE, 20, 10, 5)
    images = []
    for path in both:
        with omniscv.open_source(path) as source:
            options = {"face_size": EDGE, "filter": filter_, "strategy": "cube"}
            images.append(omniscv.render(camera, pose, source, modes=MODES, **options))
    narrow, wide = images
    np.testing.assert_array_equal(narrow.labels, wide.labels)
    np.testing.assert_array_equal(narrow.valid, wide.valid)
    rounding = narrow.depth_error / 16  # by at most 1/32 of the bound each
    assert (np.abs(narrow.depth - wide.depth) <= rounding + 1e-6 * wide.depth).all()
    np.testing.assert_allclose(narrow.normals, wide.normals, atol=1e-5)
    assert (narrow.lit != wide.lit).mean() < 1e-4


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    folder = tmp_path_factory.mktemp("overscan")
    narrow = folder / "narrow.sqlite"
    wide = folder / "wide.sqlite"
    assert record(narrow, "--overscan", "4") == {"72x72": 24}
    assert record(wide, "--overscan", "8") == {"80x80": 24}
    return narrow, wide


@pytest.mark.parametrize(("begun", "size"), [("0", "64x64"), ("20", "104x104")])
def test_a_recording_goes_on_with_its_overscan(begun, size, tmp_path):
    path = tmp_path / "room.sqlite"
    assert record(path, "--overscan", begun) == {size: 24}
    assert record(path) == {size: 24}
    assert record(path, "--position", "0,0,1.5") == {size: 48}


@pytest.mark.parametrize(
    ("source", "edge", "size"),
    [
        ("scene://four-wall", 64, "72x72"),  # a border for filters at least
        ("mock://four-wall?dialect=0.3.10&size=128x128", 128, "128x128"),
        ("recording", 64, "80x80"),
    ],
)
def test_where_overscan_cannot_be_chosen_there_is_none(source, edge, size, both, tmp_path):
    source = source.replace("recording", str(both[1]))
    assert [*record(tmp_path / "room.sqlite", source=source, edge=edge)] == [size]


def test_a_job_is_recorded_as_its_images_need_it(tmp_path):
    """Else rendering the job would capture its faces again."""
    job = tmp_path / "job.yaml"
    path = tmp_path / "room.sqlite"
    camera = "{model: equirectangular, width: 64, height: 32}"
    at = "{position: [0, 0, 1.5]}"
    more = "strategy: cube, face_size: 128, record: room.sqlite"
    job.write_text(f"{{source: mock://four-wall, cameras: {{c: {camera}}}, poses: [{at}], {more}}}")
    assert run(["record", str(job)]) == 0
    held = info(path).sizes
    assert run(["render", str(job), "--out", str(tmp_path / "out")]) == 0
    assert info(path).sizes == held == {"136x136": 6}
