"""What Rerun reads back from a file is what the images hold."""

import numpy as np
import pytest
from rerun.chunk import RrdReader
from support.exact import distance_to_surfaces

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.viewing import rerun_file
from omniscv.viewing.look import look
from omniscv.viewing.look.gathering import gather

SCENE = load_scene("four-wall")
POSES = [omniscv.Pose.from_angles((0.3 * i, 0.1, 1.5), yaw_deg=25 * i) for i in range(3)]
CAMERAS = {
    "pinhole": create("pinhole", width=48, height=32, fov_deg=80),
    "equirectangular": create("equirectangular", width=64, height=32),
}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """By stem, and as a folder."""
    out = tmp_path_factory.mktemp("images")
    found = {}
    with omniscv.open_source("scene://four-wall") as source:
        for name, camera in CAMERAS.items():
            for i, pose in enumerate(POSES):
                image = omniscv.render(camera, pose, source, ("lit", "object_mask", "depth"), face_size=64)
                image.save(out, stem=f"{name}-{i}")
                found[name, i] = image
    return found, out


@pytest.fixture(scope="module")
def columns(images):
    """By entity and column, the rows that Rerun reads, in the order of their frames."""
    path = rerun_file.write(gather(images[1]).frames, images[1] / "images.rrd")
    found = {}
    for chunk in RrdReader(path).stream():
        table = chunk.to_record_batch().to_pydict()
        frames = table.get("frame", [0] * chunk.num_rows)
        for name, rows in table.items():
            held = found.setdefault((str(chunk.entity_path), name), {})
            held.update((frame, row) for frame, row in zip(frames, rows, strict=True) if row is not None)
    return {key: [rows[frame] for frame in sorted(rows)] for key, rows in found.items()}


def of(columns, entity, ending):
    """The rows of the column whose name ends so, each without the list around it."""
    (rows,) = [rows for (path, name), rows in columns.items() if path == entity and name.endswith(ending)]
    return [np.array(row[0]) for row in rows]


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_stand_where_they_stood(name, columns):
    entity = f"/world/{name}/camera"
    for i, pose in enumerate(POSES):
        np.testing.assert_allclose(of(columns, entity, ":translation")[i], pose.position, atol=1e-6)
        matrix = of(columns, entity, ":mat3x3")[i].reshape(3, 3).T  # column by column
        np.testing.assert_allclose(matrix, pose.R_w_c, atol=1e-6)
    if name == "pinhole":
        matrix = of(columns, entity, ":image_from_camera")[0].reshape(3, 3).T
        focal = 24 / np.tan(np.radians(40))
        np.testing.assert_allclose(matrix, [[focal, 0, 24], [0, focal, 16], [0, 0, 1]], rtol=1e-6)


@pytest.mark.parametrize("name", CAMERAS)
def test_pictures_are_equal(name, columns, images):
    for i in range(len(POSES)):
        image = images[0][name, i]
        lit = of(columns, f"/images/{name}/lit", ":buffer")[i].astype(np.uint8).reshape(image.lit.shape)
        np.testing.assert_array_equal(lit, image.lit)
        depth = of(columns, f"/images/{name}/depth", ":buffer")[i].astype(np.uint8).view(np.float32)
        np.testing.assert_array_equal(depth.reshape(image.depth.shape), image.depth)
        labels = of(columns, f"/images/{name}/labels", ":buffer")[i].astype(np.uint8).view(np.uint16)
        np.testing.assert_array_equal(labels.reshape(image.labels.shape), image.labels)


@pytest.mark.parametrize("name", CAMERAS)
def test_points_lie_on_surfaces(name, columns):
    points = f"/world/{name}/points"
    (rows,) = [v for (path, key), v in columns.items() if path == points and "positions" in key]
    for row in rows:
        assert len(row) > 1000
        assert distance_to_surfaces(SCENE, np.array(row, float)).max() < 0.05


def test_objects_have_their_names(columns):
    (context,) = columns["/images/pinhole", "AnnotationContext:context"]
    told = {each["class_id"]: each["class_description"]["info"]["label"] for each in context[0]}
    assert told == {0: "nothing", **{SCENE.label(each): each for each in SCENE.objects}}


def test_another_name_is_refused_before_the_page_is_written(images, tmp_path):
    with pytest.raises(ArgumentError, match=r"expected a file NAME\.rrd, got 'room'"):
        look(images[1], tmp_path / "page.html", rerun=tmp_path / "room")
    assert list(tmp_path.iterdir()) == []
