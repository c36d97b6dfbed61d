"""COCO files: as pycocotools reads and scores them."""

import contextlib
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from pycocotools import mask as cocomask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from support.observed import framed, observed

import omniscv
from omniscv import cameras, dataset
from omniscv.frame.classes import ClassTable, SemanticClass

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # theirs

CLASSES = {
    "wall": SemanticClass(1, "wall", stuff=True),
    "chair": SemanticClass(5, "chair", "furniture"),
    "thing": SemanticClass(40, "thing"),
}
CHAIRS = ("Chair_1", "Chair_2", "Sofa")
SEAM = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=25)  # the shelf and the books are behind the camera
ASIDE = omniscv.Pose.from_angles((0.5, 0.2, 1.2), yaw_deg=100)
TRUTHS = ("boxes", "bfov", "boxes3d", "amodal")


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """A panorama and a fisheye, out of the order of their keys; the ceiling has no class."""
    folder = tmp_path_factory.mktemp("frames")
    wide = cameras.create("equirectangular", width=256, height=128)
    round_ = cameras.create("fisheye-equidistant", width=120, height=120, fov_deg=185)
    with omniscv.open_source("scene://four-wall") as source:
        of_object = dict.fromkeys(source.objects().names(), "thing") | dict.fromkeys(CHAIRS, "chair")
        of_object |= {name: "wall" for name in of_object if name.startswith("Layout")}
        del of_object["Layout_Ceiling"]
        options = {"classes": ClassTable(CLASSES, of_object), "face_size": 96}
        return [
            framed(observed(source, round_, ASIDE, **options), folder, TRUTHS, "b", split="val"),
            framed(observed(source, wide, SEAM, **options), folder, TRUTHS, "a", split="train"),
        ]


@pytest.fixture(scope="module")
def read(frames, tmp_path_factory):
    return written(frames, tmp_path_factory.mktemp("coco"))[1]


def written(frames, out, **options):
    files = dataset.get("coco").export(frames, out, options)
    with contextlib.redirect_stdout(io.StringIO()):
        return files, COCO(files[0])


def test_masks_boxes_and_areas_are_those_of_the_labels(frames, tmp_path):
    _, read = written(frames, tmp_path)
    by_key = {frame.key: frame for frame in frames}
    assert [image["key"] for image in read.dataset["images"]] == ["a", "b"]
    assert sorted(read.anns) == list(range(1, 1 + len(read.anns)))
    for each in read.anns.values():
        image = read.imgs[each["image_id"]]
        frame = by_key[image["key"]]
        mask = frame.layer("labels") == each["instance_id"]
        assert np.array_equal(read.annToMask(each), mask)
        rle = {**each["segmentation"], "counts": each["segmentation"]["counts"].encode()}
        assert each["bbox"] == cocomask.toBbox(rle).tolist()
        assert each["area"] == cocomask.area(rle) == mask.sum()
        assert frame.instances[each["name"]] == each["instance_id"]
        assert (image["width"], image["height"]) == (frame.camera.width, frame.camera.height)
        assert (tmp_path / image["file_name"]).resolve() == frame.files["lit"].resolve()
        assert cameras.from_dict(image["camera"]) == frame.camera


def test_categories_are_the_classes_that_count_and_annotations_have_fields_of_other_truths(frames, read):
    assert [(each["id"], each["name"]) for each in read.cats.values()] == [(5, "chair"), (40, "thing")]
    for each in read.anns.values():
        assert frames[0].classes.of(each["name"]).id == each["category_id"]
        assert not each["name"].startswith("Layout")
        assert 0 < each["visib_fract"] <= 1
        assert each["area_amodal"] >= each["area"]
        assert each["bfov"]["kind"] in ("perspective", "lonlat")
        assert each["distance"] > 0
        assert 0 <= each["truncated"] < 1
        assert each["name"] != "Shelf" or each["visib_fract"] < 1
    assert {each["name"] for each in read.loadAnns(read.getAnnIds(catIds=[5]))} == set(CHAIRS)


@pytest.mark.parametrize("kind", ["bbox", "segm"])
def test_perfect_detections_score_1(kind, read):
    kept = ("image_id", "category_id", "bbox", "segmentation")
    found = [{key: each[key] for key in kept} | {"score": 1.0} for each in read.anns.values()]
    with contextlib.redirect_stdout(io.StringIO()):
        score = COCOeval(read, read.loadRes(found), kind)
        score.evaluate()
        score.accumulate()
        score.summarize()
    assert score.stats[0] == score.stats[8] == 1.0  # AP, AR with 100 detections


def test_an_object_over_the_seam_is_whole_or_in_two(frames, read, tmp_path):
    whole = read
    (_, split) = written(frames, tmp_path, seam="split")
    width = frames[1].camera.width
    crossing = [each for each in whole.anns.values() if each.get("crosses_seam")]
    assert {each["name"] for each in crossing} >= {"Shelf", "Books"}
    for each in whole.anns.values():
        image = whole.imgs[each["image_id"]]
        same = each["image_id"], each["instance_id"]
        parts = [of for of in split.anns.values() if (of["image_id"], of["instance_id"]) == same]
        masks = [split.annToMask(part) for part in parts]
        assert np.array_equal(sum(masks), whole.annToMask(each))  # none twice
        if each in crossing and each["bbox_wrap"][2] < width:
            assert each["bbox"][2] == width  # as pycocotools has it
            assert each["bbox_wrap"][2] < width / 2
            assert len(parts) == 2
            assert sum(part["bbox"][2] for part in parts) <= each["bbox_wrap"][2]
            assert len({part["id"] for part in parts}) == 2
        else:
            assert len(parts) == 1
        assert ("bbox_wrap" in each) == (image["key"] == "a")


def test_without_classes_every_object_is_a_category(frames, tmp_path):
    _, read = written([replace(frame, classes=None) for frame in frames], tmp_path)
    assert {each["name"]: each["id"] for each in read.dataset["categories"]} == frames[0].instances
    assert {each["name"] for each in read.anns.values()} >= {"Layout_Floor", "Sofa"}
    assert all(each["category_id"] == each["instance_id"] for each in read.anns.values())


def test_the_order_of_frames_does_not_count_and_splits_have_files(frames, tmp_path):
    files, _ = written(frames, tmp_path / "x")
    again, _ = written(frames[::-1], tmp_path / "y")
    assert [file.stem for file in files] == ["annotations", "annotations_train", "annotations_val"]
    for a, b in zip(files, again, strict=True):
        assert a.read_bytes() == b.read_bytes()
    whole, *parts = (json.loads(file.read_text()) for file in files)
    assert [each for part in parts for each in part["annotations"]] == whole["annotations"]
    assert [[image["key"] for image in part["images"]] for part in parts] == [["a"], ["b"]]


def test_panoptic_pictures_hold_the_ids_of_their_segments(frames, tmp_path):
    files, _ = written(frames, tmp_path, panoptic=True)
    data = json.loads((tmp_path / "panoptic.json").read_text())
    assert {file.name for file in files} >= {"panoptic.json", "a.png", "b.png"}
    kinds = {each["name"]: each["isthing"] for each in data["categories"]}
    assert kinds == {"wall": 0, "chair": 1, "thing": 1}
    by_key = {frame.key: frame for frame in frames}
    for entry in data["annotations"]:
        rgb = np.array(Image.open(tmp_path / "panoptic" / entry["file_name"])).astype(int)
        ids = rgb @ [1, 256, 65536]
        labels = by_key[entry["file_name"].removesuffix(".png")].layer("labels")
        ceiling = frames[0].instances["Layout_Ceiling"]  # has no class
        assert np.array_equal(ids, np.where(labels == ceiling, 0, labels))
        counted = {each["id"]: each["area"] for each in entry["segments_info"]}
        assert counted == {i: int((ids == i).sum()) for i in np.unique(ids).tolist() if i}
