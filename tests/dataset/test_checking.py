"""``dataset check``: every fault is one line that names the file, and a dataset as it was made has none."""

import json

import numpy as np
import pytest

from omniscv import cli, dataset, modalities, storage
from omniscv.compose.files import write_picture
from omniscv.dataset import manifest
from omniscv.errors import DatasetError
from omniscv.frame import FileEntry


def relisted(out, key, kind):
    """Enter a file of a frame as it is now, with its checksum, as an attacker or a faulty tool would."""
    entries = {entry.key: entry for entry in manifest.read_frames(out)}
    own = out / f"{key}.json"
    said = json.loads(own.read_bytes())
    entry = FileEntry.of(out / said["frame"]["files"][kind]["path"])
    said["frame"]["files"][kind] = {"path": entry.path, "bytes": entry.bytes, "sha256": entry.sha256}
    own.write_text(json.dumps(said, indent=2) + "\n", encoding="utf-8")
    whole = manifest.read(out)
    entries[key] = whole.frame_of_file(own.name, own.read_bytes(), storage.folder(out))
    manifest.write_frames(out, entries.values())


def changed(out, key, layer, change):
    """Change a layer of a frame, and enter it."""
    frame = next(frame for frame in dataset.open(out) if frame.key == key)
    pixels = frame.layer(layer).copy()
    change(pixels, frame.valid)
    write_picture(frame.files[layer], pixels, modalities.get(layer))
    relisted(out, key, layer)


def test_a_dataset_as_it_was_made_has_no_faults(whole):
    assert dataset.check(whole / "dataset") == []
    assert dataset.check(whole / "dataset", deep=True) == []
    assert dataset.check(whole / "dataset", format="webdataset") == []


def lose(out):
    (out / "lens-0.depth.exr").unlink()
    return "lens-0.depth.exr: expected a file, it is missing"


def lengthen(out):
    with (out / "pano-1.lit.png").open("ab") as file:
        file.write(b"x")
    return "pano-1.lit.png: expected"


def flip(out):
    data = bytearray((out / "pano-1.labels.png").read_bytes())
    data[-20] ^= 1
    (out / "pano-1.labels.png").write_bytes(data)
    return "pano-1.labels.png: expected the bytes of its checksum"


def unlist(out):
    lines = (out / "frames.jsonl").read_text(encoding="utf-8").splitlines()
    (out / "frames.jsonl").write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
    return "pano-2.json: expected a frame that frames.jsonl lists"


def disorder(out):
    lines = (out / "frames.jsonl").read_text(encoding="utf-8").splitlines()
    (out / "frames.jsonl").write_text("\n".join(lines[::-1]) + "\n", encoding="utf-8")
    return "frames.jsonl: expected every key once, in their order"


def cut(out):
    data = (out / "frames.jsonl").read_bytes()
    (out / "frames.jsonl").write_bytes(data[: len(data) // 2 + 50])
    return "frames.jsonl: expected a file of a dataset"


def leak(out):
    entries = list(manifest.read_frames(out))
    text = (out / "frames.jsonl").read_text(encoding="utf-8")
    other = {"train": "val", "val": "train"}[entries[0].split]
    text = text.replace(f'"split": "{entries[0].split}"', f'"split": "{other}"', 1)
    (out / "frames.jsonl").write_text(text, encoding="utf-8")
    return "of its place, got"


def rewrite(path, old, new):
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")


def escape(out):
    rewrite(out / "frames.jsonl", "lens-0.lit.png", "../lens-0.lit.png")
    return "expected the name of a file of the dataset"


def rename_object(out):
    rewrite(out / "dataset.json", '"Ball": 1,', '"Bell": 1,')
    return "dataset.json: classes: expected what its rules and names give"


def share_an_id(out):
    rewrite(out / "dataset.json", '"Books": 2,', '"Books": 1,')
    return "dataset.json: names: expected another id for each"


def climb(out):
    rewrite(out / "frames.jsonl", '"key": "lens-0"', '"key": "../x"')
    return "key: expected the start of a file name without a dot"


def lose_an_export(out):
    (out / "exports" / "webdataset" / "shards.json").rename(out / "exports" / "shards.json")
    (out / "exports" / "webdataset").rename(out / "exports" / "other")
    return "exports/webdataset: expected an export to webdataset, it is missing"


FAULTS = [
    lose,
    lengthen,
    flip,
    unlist,
    disorder,
    cut,
    leak,
    escape,
    rename_object,
    share_an_id,
    climb,
    lose_an_export,
]


@pytest.mark.parametrize("damage", FAULTS)
def test_a_fault_is_one_line_and_exit_code_1(damage, copied, capsys):
    says = damage(copied)
    found = dataset.check(copied)
    assert any(says in line for line in found), found
    assert cli.run(["dataset", "check", str(copied)]) == 1
    assert says in capsys.readouterr().out


def strange_label(pixels, valid):
    pixels[valid] = 999


def label_outside(pixels, valid):
    pixels[~valid] = 1


def other_class(pixels, valid):
    pixels[np.nonzero(valid)[0][0], np.nonzero(valid)[1][0]] += 1


def not_a_number(pixels, valid):
    pixels[valid] = np.nan


def nothing_inside(pixels, valid):
    pixels[valid] = 0


def something_outside(pixels, valid):
    pixels[~valid] = np.inf


def long_normal(pixels, valid):
    pixels[valid] *= 2


@pytest.mark.parametrize(
    ("layer", "change", "says"),
    [
        ("labels", strange_label, "labels: expected instance ids of the dataset"),
        ("labels", label_outside, "labels: expected 0 outside the field of view"),
        ("labels", strange_label, "classes: expected the class of the object in labels"),
        ("classes", other_class, "classes: expected the class of the object in labels, got 1 other"),
        ("depth", not_a_number, "depth: expected metres >= 0, or inf"),
        ("depth", nothing_inside, "depth: expected more than 0 m inside the field of view"),
        ("depth", something_outside, "depth: expected 0 outside the field of view"),
        ("normals", long_normal, "normals: expected unit vectors, or 0"),
    ],
)
def test_deep_faults_are_found_behind_right_checksums(layer, change, says, copied):
    changed(copied, "lens-1", layer, change)
    assert dataset.check(copied) == []
    found = dataset.check(copied, deep=True)
    assert any(line.startswith(f"lens-1: {says}") for line in found), found


def test_records_are_json_of_objects_that_the_dataset_has(copied):
    own = copied / "pano-0.json"
    said = json.loads(own.read_bytes())
    for text, says in (
        ('{"boxes": [{"instance_id": 777, "name": "Ball", "bbox": [0, 0, 1, 1]}]}', "got 'Ball' as 777"),
        ('{"boxes": [{"instance_id": 1, "name": "Ball"}]}', "boxes[0]: missing key 'bbox'"),
        (
            '{"boxes": [{"instance_id": 1, "name": "Ball", "bbox": [0, 0, 99, 9]}]}',
            "expected a box in the image",
        ),
        ('{"boxes": [[[1]]]}', "boxes[0]: expected a mapping"),
        ('{"poses": {"Ball": {"position": "\\ud800", "rotation": 1}}}', "expected texts of Unicode"),
        ("5", "truth: expected a mapping, got 5"),
        ("[" * 100_000, "expected JSON"),
        ('{"boxes": [{"x": NaN}]}', "NaN, which JSON does not have"),
        ('{"boxes": [', "expected JSON"),
    ):
        (copied / "pano-0.truth.json").write_text(text, encoding="utf-8")
        said["frame"]["files"]["truth"] = {"path": "pano-0.truth.json", "bytes": 0, "sha256": "0" * 64}
        own.write_text(json.dumps(said), encoding="utf-8")
        relisted(copied, "pano-0", "truth")
        assert dataset.check(copied) == []
        (line,) = dataset.check(copied, deep=True)
        assert line.startswith("pano-0.truth.json: ")
        assert says in line
        with pytest.raises(DatasetError) as refused:
            dataset.export(copied, "coco")
        assert line in str(refused.value)


def test_an_incomplete_dataset_is_a_fault(copied, capsys):
    (copied / "frames.jsonl").unlink()
    assert cli.run(["dataset", "check", str(copied)]) == 1
    assert "make JOB --resume" in capsys.readouterr().out
    assert cli.run(["dataset", "export", str(copied), "--to", "hf"]) == 1


def test_an_export_without_a_check_of_its_own_is_made_again_and_compared(copied):
    dataset.export(copied, "hf")
    assert dataset.check(copied, format="hf") == []
    (copied / "exports" / "hf" / "README.md").write_text("mine", encoding="utf-8")
    (copied / "exports" / "hf" / "train" / "pano-0.lit.png").unlink(missing_ok=True)
    (copied / "exports" / "hf" / "strange").touch()
    found = dataset.check(copied, format="hf")
    assert "exports/hf: README.md: expected what the frames give, got other bytes" in found
    assert "exports/hf: strange: expected no such file" in found
