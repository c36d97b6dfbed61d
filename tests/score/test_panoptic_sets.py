"""Panoptic quality of a set is that of its pictures beside each other; the command reads ids of instances."""

import json

import numpy as np
import pytest

import omniscv
from omniscv import cameras, dataset, score
from omniscv.cli import run
from omniscv.errors import ArgumentError
from omniscv.score.labels import panoptic_image, panoptic_set

CAMERA = cameras.create("pinhole", 24, 16, fov_deg=60)
SHAPE = (16, 24)
RNG = np.random.default_rng(9)


def blocks(first_id):
    """A picture of 24 instances in blocks of 4 x 4 px, ids ``class * 1000 + number``, of three classes."""
    picture = np.empty(SHAPE, np.int64)
    for row in range(4):
        for column in range(6):
            number = 6 * row + column
            picture[4 * row : 4 * row + 4, 4 * column : 4 * column + 4] = (
                1000 * (1 + number % 3) + first_id + number
            )
    return picture


def class_of(instance):
    return instance // 1000


def worn(truth, share):
    """The picture with some pixels of other instances, and one instance of another class."""
    picture = truth.copy()
    changed = RNG.random(SHAPE) < share
    picture[changed] = np.roll(truth, 5, axis=1)[changed]
    one = truth[0, 0]
    picture[picture == one] = one + 1000
    return picture


def test_a_set_is_scored_as_its_pictures_beside_each_other():
    truths = [blocks(100), blocks(300)]
    predictions = [worn(truths[0], 0.3), worn(truths[1], 0.5)]
    doubt = np.zeros(SHAPE, bool)
    images = []
    for p, t in zip(predictions, truths, strict=True):
        images.append(panoptic_image(p, t, CAMERA, doubt, class_of, class_of))
    by_pixel, _ = panoptic_set(images)
    p = np.hstack(predictions)
    t = np.hstack(truths)
    classes = {int(instance): class_of(int(instance)) for instance in np.unique([p, t])}
    whole = score.panoptic(p, t, classes, classes)
    assert by_pixel == whole
    assert 0.1 < whole.pq < 0.9


def test_pixels_in_doubt_are_unknown():
    truth = blocks(100)
    doubt = RNG.random(SHAPE) < 0.4
    predicted = np.where(doubt, 9001, truth)
    scores = panoptic_image(predicted, truth, CAMERA, doubt, class_of, class_of)
    assert scores.by_pixel.pq == scores.by_solid_angle.pq == 1
    assert scores.in_doubt == doubt.sum()


def test_a_picture_without_a_known_instance_is_refused():
    nothing = np.zeros(SHAPE, int)
    with pytest.raises(ArgumentError, match="expected a pixel with an instance beyond doubt"):
        panoptic_image(blocks(100), nothing, CAMERA, nothing > 0, class_of, class_of)


RULES = {"rules": [{"match": "Layout_*", "class": "room", "stuff": True}, {"match": "*", "class": "thing"}]}


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """A dataset with classes, and a folder of predictions: the truth, as ``class * 1000 + number``."""
    folder = tmp_path_factory.mktemp("rooms")
    camera = cameras.create("equirectangular", 96, 48)
    with (
        omniscv.open_source("scene://four-wall") as source,
        dataset.Writer(folder / "set", classes=RULES) as writer,
    ):
        for number in range(2):
            pose = omniscv.Pose.from_angles((0.2 * number, 0, 1.4), 30 * number)
            image = omniscv.render(camera, pose, source, ("object_mask", "depth"), face_size=64)
            writer.add(f"room-{number}", image)
    (folder / "exact").mkdir()
    for frame in dataset.open(folder / "set"):
        instances = frame.layer("labels").astype(np.int64)
        classes = frame.classes.ids(frame.instances)[instances]
        np.save(folder / "exact" / f"{frame.key}.npy", np.where(instances > 0, 1000 * classes + instances, 0))
    return folder


def quality(capsys, *arguments):
    assert run(["score", *map(str, arguments), "--what", "panoptic", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["mean"]["by_pixel"]


def test_the_truth_itself_has_the_quality_of_one(rooms, capsys):
    assert quality(capsys, rooms / "exact", rooms / "set") == {"pq": 1, "sq": 1, "rq": 1}


def test_things_in_one_instance_have_less(rooms, tmp_path, capsys):
    for path in (rooms / "exact").iterdir():
        values = np.load(path)
        np.save(tmp_path / path.name, 1000 * (values // 1000))
    merged = quality(capsys, tmp_path, rooms / "set")
    assert merged["pq"] < 0.5
