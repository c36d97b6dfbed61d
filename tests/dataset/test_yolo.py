"""The export yolo, judged by a reader of its rules."""

import cv2
import numpy as np
import pytest
import yaml

from omniscv.dataset import export, open
from omniscv.job import load
from omniscv.make import make


def read(root, split="train"):
    """By image, the boxes (px) or filled contours of its rows; AssertionError for what readers drop."""
    data = yaml.safe_load((root / "data.yaml").read_text())
    names, found = data["names"], {}
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
            number, values = int(row[0]), np.array(row[1:], float)
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


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    camera = {"model": "pinhole", "width": 101, "height": 67, "fov_deg": 90}
    poses = [{"position": [0, 0, 1.5], "yaw_deg": yaw} for yaw in (0, 120)]
    job = {"source": "scene://four-wall", "cameras": {"front": camera}, "poses": poses}
    job |= {"modes": ["lit", "object_mask"], "out": str(tmp_path_factory.mktemp("yolo") / "d")}
    make(load(job))
    return job["out"]


def test_boxes_and_contours_give_back_the_labels(dataset, tmp_path):
    frames = {frame.key: frame for frame in open(dataset)}
    for task in ("detect", "segment"):
        export(dataset, "yolo", str(tmp_path / task), task=task)
    boxes, shapes = read(tmp_path / "detect"), read(tmp_path / "segment")
    assert boxes.keys() == shapes.keys() == frames.keys()
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
            assert (shape | largest == shape).all()  # a row has no holes: nothing is lost but other parts
            outside = cv2.connectedComponents((~largest).astype(np.uint8), connectivity=4)[1]
            border = {*outside[0], *outside[-1], *outside[:, 0], *outside[:, -1]} - {0}
            assert not (shape & np.isin(outside, list(border))).any()
