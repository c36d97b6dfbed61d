"""The export yolo, judged by a reader of its rules."""

import cv2
import numpy as np
import pytest
import yaml

from mock_server import load_scene
from omniscv.dataset import export, open
from omniscv.dataset.formats.outlines import outline
from omniscv.job import load
from omniscv.make import make


def read(root, split="train"):
    """By image, the boxes (px) or filled contours of its rows; AssertionError for what readers drop."""
    data = yaml.safe_load((root / "data.yaml").read_text())
    names = data["names"]
    found = {}
    assert list(names) == list(range(len(names)))
    for image in sorted((root / data[split]).iterdir()):
        start, _, end = str(image).rpartition("/images/")
        label = root.__class__(f"{start}/labels/{end}").with_suffix(".txt")
        height, width = cv2.imread(str(image)).shape[:2]
        assert min(height, width) >= 10
        rows = [line.split() for line in label.read_text().splitlines()] if label.exists() else []
        polygons = any(len(row) > 6 for row in rows)
        found[image.stem] = []
        for row in rows:
            number = int(row[0])
            values = np.array(row[1:], float)
            assert number in names
            assert ((values >= -0.01) & (values <= 1.01)).all()
            assert len(values) % 2 == 0
            assert polygons or len(values) == 4
            if polygons:
                points = (values.reshape(-1, 2) * [width, height]).astype(np.int32)
                shape = cv2.fillPoly(np.zeros((height, width), np.uint8), [points], 1) > 0
            else:
                x, y, across, down = values * [width, height, width, height]
                shape = [x - across / 2, y - down / 2, across, down]
            found[image.stem].append((names[number], shape))
    return found


def made(folder, yaws, **keys):
    camera = {"model": "pinhole", "width": 101, "height": 67, "fov_deg": 90}
    poses = [{"position": [0, 0, 1.5], "yaw_deg": yaw} for yaw in yaws]
    job = {"source": "scene://four-wall", "cameras": {"front": camera}, "poses": poses, **keys}
    make(load({**job, "out": str(folder / "d")}))
    return str(folder / "d")


def test_boxes_and_contours_give_back_the_labels(tmp_path):
    dataset = made(tmp_path, (0, 120), modes=["lit", "object_mask"])
    frames = {frame.key: frame for frame in open(dataset)}
    for task in ("detect", "segment"):
        export(dataset, "yolo", str(tmp_path / task), task=task)
    boxes = read(tmp_path / "detect")
    shapes = read(tmp_path / "segment")
    assert boxes.keys() == shapes.keys() == frames.keys()
    lost = total = 0
    for key, frame in frames.items():
        labels = frame.layer("labels")
        for (name, box), (same, shape) in zip(boxes[key], shapes[key], strict=True):
            mask = labels == frame.instances[name]
            rows, columns = np.nonzero(mask)
            edges = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
            np.testing.assert_allclose(box, edges, atol=2e-4)  # six decimals of a share
            parts, part_of = cv2.connectedComponents(mask.astype(np.uint8))
            largest = part_of == 1 + np.argmax([np.sum(part_of == part) for part in range(1, parts)])
            assert same == name
            lost = lost + np.sum(mask != shape)
            total = total + np.sum(mask)
            assert (shape == largest).all()
    data = yaml.safe_load((tmp_path / "segment" / "data.yaml").read_text())
    assert data["lost"] == round(lost / total, 6) > 0


def masks():
    """Rings, frames of frames, leaves with holes of a pixel, walls of a pixel between holes."""
    yy, xx = np.mgrid[:120, :160]
    away = np.hypot(xx - 80, yy - 60)
    rng = np.random.default_rng(3)
    leaves = cv2.GaussianBlur(rng.random((120, 160)), (0, 0), 1.2) > 0.48
    grid = (xx % 4 == 0) | (yy % 5 == 0)
    yield (
        "frame",
        (np.maximum(abs(xx - 80), abs(yy - 60)) < 50) & (np.maximum(abs(xx - 80), abs(yy - 60)) >= 40),
    )
    yield "blob in a ring", ((away < 55) & (away > 53)) | (away < 40)
    yield "leaves", leaves
    yield "grid", grid
    yield "dots", grid | (rng.random((120, 160)) < 0.3)
    yield "line", yy == 3


@pytest.mark.parametrize("mask", [pytest.param(mask, id=name) for name, mask in masks()])
def test_a_mask_with_holes_is_one_line_that_readers_fill_to_it(mask):
    """Readers cut shares of six decimals to whole pixels, and fill by cv2."""
    points = (np.round((outline(mask.astype(np.uint8)) + 0.45) / (160, 120), 6) * (160, 120)).astype(np.int32)
    filled = cv2.fillPoly(np.zeros(mask.shape, np.uint8), [points], 1) > 0
    _, part_of, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    largest = part_of == 1 + stats[1:, cv2.CC_STAT_AREA].argmax()
    assert (filled & largest).sum() / (filled | largest).sum() >= 0.98


def test_a_pose_is_the_box_in_space(tmp_path):
    """The corners again by hand, and what a tracer sees of their places."""
    modes = ["lit", "object_mask", "depth"]
    out = made(tmp_path, (0,), modes=modes, face_size=101, truth={"boxes3d": True})
    export(out, "yolo", str(tmp_path / "pose"), task="pose")
    data = yaml.safe_load((tmp_path / "pose" / "data.yaml").read_text())
    assert (data["kpt_shape"], sorted(data["flip_idx"])) == ([9, 3], list(range(9)))
    (frame,) = open(out)
    boxes = {box["name"]: box for box in frame.truth["boxes3d"]}
    scene = load_scene("four-wall")
    agreed = []
    flags = set()
    for line in (tmp_path / "pose/labels/train/front.txt").read_text().splitlines():
        number, *values = line.split()
        assert len(values) == 4 + 9 * 3
        box = boxes[data["names"][int(number)]]
        points = np.array(values[4:], float).reshape(9, 3)
        R_w_b = np.array(box["R_world_box"])
        size = np.array(box["size"])
        signs = [(x, y, z) for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))] + [(0, 0, 0)]
        for (u, v, flag), sign in zip(points, signs, strict=True):
            point_w = np.array(box["center_world"]) + R_w_b @ (size / 2 * sign)
            x, y, z = frame.pose.R_w_c.T @ (point_w - frame.pose.position)
            expected = np.array([50.5 * x / z + 50.5, 50.5 * y / z + 33.5]) / [101, 67] if z > 0 else [-1, -1]
            if not ((np.array(expected) >= 0) & (np.array(expected) < 1)).all():
                assert (u, v, flag) == (0, 0, 0)
                continue
            np.testing.assert_allclose((u, v), expected, atol=1e-6)
            away = point_w - frame.pose.position
            hit = scene.trace(frame.pose.position, (away / np.linalg.norm(away))[None])
            if abs(hit.distance[0] / np.linalg.norm(away) - 1) < 0.03:
                continue  # it touches what is seen
            free = hit.distance[0] >= np.linalg.norm(away) or scene.objects[hit.label[0] - 1] == box["name"]
            agreed.append(flag == 1 + free)
            flags.add(flag)
    assert flags == {1, 2}
    assert np.mean(agreed) > 0.9  # the middle of a pixel may be beside the edge that hides a corner
    flipped = np.array(signs)[data["flip_idx"]]
    np.testing.assert_array_equal(flipped, np.array(signs) * [1, -1, 1])
