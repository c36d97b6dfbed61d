"""``store: fast``: the same layers as arrays of Blosc2, read by all that reads datasets."""

import json
import shutil
import sys
import tracemalloc

import blosc2
import numpy as np
import pytest
from support.datasets import enter, image, job_file, made, tree

from omniscv import dataset, storage
from omniscv.compose.files import check_header, read
from omniscv.dataset.formats.webdataset import Shard, read_list
from omniscv.errors import ArgumentError, DatasetError, OmniscvError
from omniscv.job import load
from omniscv.make import make
from omniscv.pictures.forms import encode_array

PICTURES = (".png", ".exr")
MORE = "truth: {boxes: true, layout: true}\n"


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stores")
    return made(folder, more=MORE), made(folder, out="fast", more=f"{MORE}store: fast\n")


@pytest.fixture
def fast(stores, tmp_path):
    return shutil.copytree(stores[1], tmp_path / "fast")


def test_both_stores_hold_the_same_frames(stores):
    files, fast = map(dataset.open, stores)
    for ours, theirs in zip(fast, files, strict=True):
        assert ours.files.keys() == theirs.files.keys()
        assert (ours.truth, ours.layout, ours.blank) == (theirs.truth, theirs.layout, theirs.blank)
        for name in (name for name, path in theirs.files.items() if path.suffix in PICTURES):
            assert ours.files[name].suffix == ".b2nd"
            ours_layer = ours.layer(name)
            layer = theirs.layer(name)
            assert ours_layer.dtype == layer.dtype
            np.testing.assert_array_equal(ours_layer, layer, err_msg=name)
    assert not list(dataset.check(stores[1], deep=True))
    read = blosc2.open(str(ours.files["depth"]), mode="r")[:]  # as any reader of Blosc2
    np.testing.assert_array_equal(read, ours.layer("depth"))


def test_equal_frames_make_equal_bytes(stores, tmp_path):
    assert tree(made(tmp_path, out="fast", more=f"{MORE}store: fast\n")) == tree(stores[1])


@pytest.mark.parametrize("name", ["coco", "nerfstudio"])
def test_exports_are_those_of_files(stores, tmp_path, name):
    """Pictures of exports are made of arrays; names that lead out of an export lead to pictures in it."""
    made_of = []
    for store in stores:
        out = tmp_path / store.name
        dataset.export(store, name, out, cameras=["lens" if name == "nerfstudio" else "pano"])
        made_of.append({path: digest for path, digest in tree(out).items() if path.endswith(PICTURES)})
    files, fast = made_of
    assert fast.items() >= files.items()
    if name == "coco":
        named = json.loads((out / "annotations.json").read_bytes())["images"]
        assert {image["file_name"] for image in named} == fast.keys()


def test_packed_samples_are_the_frames(stores, tmp_path):
    dataset.export(stores[1], "webdataset", tmp_path / "shards", cameras=["pano"])
    manifest, shards = read_list(storage.folder(tmp_path / "shards"))
    by_key = {frame.key: frame for frame in dataset.open(stores[1])}
    for file, keys in shards.items():
        shard = Shard(storage.folder(tmp_path / "shards"), file, manifest)
        for key in keys:
            frame = shard.extract(key, ("depth",), tmp_path)
            np.testing.assert_array_equal(frame.layer("depth"), by_key[key].layer("depth"))
        shard.close()


def test_rendered_images_are_stored_fast_too(tmp_path):
    image().save(tmp_path, "a", store="fast")
    np.testing.assert_array_equal(read(tmp_path / "a.labels.b2nd", "labels"), image()["labels"])
    assert {path.suffix for path in tmp_path.iterdir()} == {".b2nd", ".json"}


# -- what is refused -------------------------------------------------------------------------------------


def test_without_the_package_nothing_is_captured(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "blosc2", None)
    with pytest.raises(OmniscvError, match=r"store: .*blosc2; pip install 'omniscv\[fast\]'"):
        make(load(job_file(tmp_path, source="unrealcv://127.0.0.1:1", more="store: fast\n")))


def test_a_dataset_has_one_store(stores, tmp_path):
    out = shutil.copytree(stores[0], tmp_path / "dataset")
    before = tree(out)
    with pytest.raises(ArgumentError, match="store"):
        make(load(job_file(tmp_path, more=f"{MORE}store: fast\n")), existing="resume")
    assert tree(out) == before


def array(pixels, **settings):
    return blosc2.asarray(np.ascontiguousarray(pixels), **settings).to_cframe()


FAR = np.zeros((24, 48), np.float32)
SPOILED = {
    "no array": b"\x89PNG" * 99,
    "nothing": b"",
    "cut": array(FAR)[:-20],
    "another size": encode_array(np.zeros((24, 49), np.float32)),
    "another type": encode_array(np.zeros((24, 48), np.float64)),
    "channels": encode_array(np.zeros((24, 48, 3), np.float32)),
    "one dimension": encode_array(np.zeros(24 * 48, np.float32)),
    "texts": array(np.full((24, 48), "x" * 400)),
    "many chunks": array(FAR, chunks=(8, 8)),
    "a chunk beyond the array": array(FAR, chunks=(64, 64), blocks=(64, 64)),
    "a gigabyte of nothing": array(blosc2.zeros((1 << 14, 1 << 14), np.float32)),
}


@pytest.mark.parametrize("content", SPOILED.values(), ids=SPOILED)
def test_other_arrays_are_refused(fast, content):
    (fast / "pano-0.depth.b2nd").write_bytes(content)
    enter(fast, "pano-0", "depth")
    frame = dataset.open(fast)[-3]
    assert frame.key == "pano-0"
    tracemalloc.start()
    with pytest.raises(DatasetError, match=r"pano-0\.depth\.b2nd: expected"):
        frame.layer("depth")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20


def test_changed_bytes_are_refused_or_read(fast):
    """Checksums of a hostile dataset are right: its bytes reach the reader."""
    path = fast / "pano-0.labels.b2nd"
    whole = path.read_bytes()
    random = np.random.default_rng(7)
    refused = 0
    for _ in range(300):
        spoiled = bytearray(whole)
        for at in random.integers(0, min(len(whole), 500), random.integers(1, 4)):
            spoiled[at] = random.integers(256)
        path.write_bytes(spoiled)
        try:
            check_header(path, "labels", (48, 24))
            layer = read(path, "labels")
            assert (layer.shape, layer.dtype) == ((24, 48), np.uint16)
        except ArgumentError:
            refused += 1
    assert 0 < refused < 300
