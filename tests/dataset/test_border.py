"""The border of datasets: whatever a folder holds, every reader refuses the same fault in one line."""

import json
import os

import cv2
import numpy as np
import pytest
from support.datasets import enter, relisted, tree

from omniscv import cameras, cli, dataset
from omniscv.errors import ArgumentError, DatasetError
from omniscv.frame.forms import checked
from omniscv.job import load
from omniscv.make import make
from omniscv.pictures import png
from omniscv.viewing.look import look

# -- what a dataset may hold: each changes one, and returns what every reader says --------------------------


def blank_colours(out):
    """Layers without a file are marks that no pixel has."""
    relisted(out, lambda lines: [{**line, "blank": ["lit"]} for line in lines])
    return "blank: expected one of label_edge, occluded, relit, unsure, doubt, unseen; got 'lit'"


def swap_labels(out):
    a, b = (out / f"pano-{i}.labels.png" for i in range(2))
    kept = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(kept)
    return "pano-0.labels.png: expected"


def link_to_a_private_file(out):
    private = out.parent / "private.png"
    (out / "pano-0.lit.png").rename(private)
    (out / "pano-0.lit.png").symlink_to(private)
    return "pano-0.lit.png: expected a regular file, got a link"


def pipe(out):
    (out / "pano-0.lit.png").unlink()
    os.mkfifo(out / "pano-0.lit.png")
    return "pano-0.lit.png: expected a regular file, got a folder, a device or a pipe"


def twice(out):
    relisted(out, lambda lines: [lines[0], *lines])
    return "frames.jsonl: expected every key once"


def executable(out):
    """WebDataset's default decoder unpickles members that end in .pyd."""
    (out / "pano-0.notes.pyd").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    enter(out, "pano-0", "notes", "pano-0.notes.pyd")
    return "pano-0"


def huge_picture(out):
    """A label picture of 3000 x 3000 for a camera of 48 x 24: the size is read first, the pixels are cut."""
    (out / "pano-0.labels.png").write_bytes(png.encode(np.zeros((3000, 3000), np.uint16))[:200])
    enter(out, "pano-0", "labels")
    return "pano-0.labels.png: expected 48x24 px, as its camera has, got 3000x3000"


def tiff_as_png(out):
    (out / "pano-0.lit.png").write_bytes(cv2.imencode(".tiff", np.zeros((24, 48, 3), np.uint8))[1].tobytes())
    enter(out, "pano-0", "lit")
    return "pano-0.lit.png: expected a picture of lit, got: expected a PNG"


def opened(out):
    for frame in dataset.open(out):
        frame.layers("lit", "labels", "depth")


READERS = {
    "open": opened,
    "coco": lambda out: dataset.export(out, "coco", out.parent / "coco"),
    "webdataset": lambda out: dataset.export(out, "webdataset", out.parent / "shards"),
    "look": lambda out: look(out, out.parent / "page.html"),
}


@pytest.mark.parametrize(
    "change",
    [blank_colours, swap_labels, link_to_a_private_file, pipe, twice, executable, huge_picture, tiff_as_png],
)
def test_every_reader_refuses_damaged_datasets(change, copied, capsys):
    says = change(copied)
    for name, reader in READERS.items():
        with pytest.raises(DatasetError) as refused:
            reader(copied)
        assert says in str(refused.value), name
    assert not {"page.html", "coco", "shards"} & {path.name for path in copied.parent.iterdir()}
    assert cli.run(["dataset", "check", str(copied)]) == 1
    assert says in capsys.readouterr().out


@pytest.mark.timeout(30)
def test_patterns_of_a_dataset_are_not_run_where_it_is_read(copied):
    """Python would try every division of 40 letters."""
    path = copied / "dataset.json"
    stored = json.loads(path.read_bytes())
    stored["names"]["a" * 40 + "!"] = len(stored["names"]) + 1
    stored["classes"]["rules"].insert(0, {"regex": "(a+)+", "class": "chair"})
    path.write_text(json.dumps(stored), encoding="utf-8")
    opened(copied)
    dataset.export(copied, "coco")


def test_frames_whose_files_are_damaged_or_pipes_or_links_are_made_again(copied):
    """A pipe would be waited for, a link followed."""
    before = tree(copied)
    for name in ("pano-0.json", "lens-1.depth.exr"):
        (copied / name).unlink()
        os.mkfifo(copied / name)
    (copied / "pano-1.lit.png").rename(copied.parent / "private.png")
    (copied / "pano-1.lit.png").symlink_to(copied.parent / "private.png")
    (copied / "lens-0.depth.exr").unlink()
    (copied / "pano-1.labels.png").write_bytes(b"damaged")
    (copied / "pano-2.json").write_text("{", encoding="utf-8")
    made = make(load(copied.parent / "dataset.yaml"), existing="resume")
    assert (made.written, made.kept) == (5, 1)
    assert tree(copied) == before
    assert not (copied / "pano-1.lit.png").is_symlink()


def test_a_corner_in_the_image_has_its_pixel():
    corner = {"kind": "floor", "world": [1, 2, 0], "in_image": True, "visible_room": True, "visible": None}
    layout = {"version": 1, "corners": [corner], "edges": []}
    camera = cameras.create("equirectangular", width=8, height=4)
    with pytest.raises(ArgumentError, match="pixel"):
        checked("layout", layout, camera, {})
