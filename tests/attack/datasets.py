"""Datasets that others have made: folders, records, names and shards, spoiled.

Whatever reads one either raises a clear refusal or returns what was made.
"""

import atexit
import contextlib
import io
import json
import shutil
import tarfile
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path

from support.datasets import enter, first_of, image, job_file

from attack.commands import clear, nothing_left, ran, require
from attack.spoiling import bytes_changed, head, regular_files, spoil_file, strange, text_changed, write
from attack.words import YAML
from omniscv import dataset, storage
from omniscv.dataset.formats.webdataset import Shard, read_list
from omniscv.errors import OmniscvError
from omniscv.job import load
from omniscv.make import make

MORE = "truth: {boxes: true, bfov: true, boxes3d: true, layout: true}\nexport: [webdataset]\n"
FORMATS = ("coco", "webdataset", "ply", "flow", "nerfstudio", "kalibr", "poses", "colmap")


@cache
def made():
    """The folder of a small dataset and, by key and kind, the bytes of its layers in memory."""
    home = Path(tempfile.mkdtemp(prefix="attack-dataset-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    job = first_of(load(job_file(home, more=MORE)), 2)
    make(job)
    return job.out, dict(contents(dataset.open(job.out)))


@cache
def stores():
    """The folder of that dataset, and of the same in the store ``fast``."""
    out, _ = made()
    job = first_of(load(job_file(out.parent, out="fast", more=f"{MORE}store: fast\n")), 2)
    make(job)
    return out, job.out


def contents(frames):
    """Yield key, kind and content of everything that frames hold."""
    for frame in frames:
        for kind in frame.files:
            if kind in ("truth", "layout"):
                yield (frame.key, kind), json.dumps(frame.records(kind), sort_keys=True)
            elif kind != "image":
                yield (frame.key, kind), frame.layer(kind).tobytes()


def listed(out, path):
    """Enter a file as it is now into ``frames.jsonl`` and its frame's own file, with size and checksum."""
    key, kind = path.name.split(".")[:2]
    if not ((out / f"{key}.json").is_file() and (out / "frames.jsonl").is_file()):
        raise OSError("spoiled before")
    enter(out, key, kind, path.name)


def spoil(rng, out):
    """Change a file of a dataset; return whether what it holds may differ from what was made, unnoticed."""
    files = regular_files(out)
    manifests = [each for each in files if each.name in ("dataset.json", "frames.jsonl")]
    path = rng.choice([*files, *manifests * 8])
    if rng.random() < 0.2:
        strange(rng, path)
    elif path.name == "frames.jsonl":
        lines = head(path).decode(errors="replace").splitlines() or [""]
        i = rng.randrange(len(lines))
        lines[i : i + 1] = rng.choice([[], [lines[i]] * 2, *[[text_changed(rng, lines[i])]] * 6])
        path.write_bytes("".join(f"{line}\n" for line in lines).encode("utf-8", "surrogatepass"))
        return True
    elif path.suffix == ".json":
        write(path, text_changed(rng, head(path).decode(errors="replace")))
        return path.name == "dataset.json"
    else:
        path.write_bytes(bytes_changed(rng, head(path)))
        # spoiled before
        with contextlib.suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
            if rng.random() < 0.5:
                listed(out, path)
                return True
    return False


def used(rng, work, changed):
    """Read a dataset by commands and from Python."""
    checked = ran(["dataset", "check", "room", "--deep"])
    ran(["dataset", "info", "room"])
    format = rng.choice(FORMATS)
    exported = ran(["dataset", "export", "room", "--to", format, "--out", "out"])
    require(exported.code == 0 or not (work / "out").exists(), f"a refused export to {format} left files")
    ran(["look", "room", "--out", "page.html"])
    try:
        found = dict(contents(dataset.open("room")))
    except OmniscvError as error:
        clear(error)
        require(checked.code, f"check finds nothing, reading: {error}")
    else:
        wrong = [key for key, content in found.items() if made()[1].get(key) != content]
        require(changed or not wrong, f"other data than was made: {wrong[:3]}; check: {checked.out}")


def case(rng, folder):
    """A spoiled dataset is refused, by every reader, or is what was made."""
    true = rng.choice(stores())
    with nothing_left(folder) as work:
        shutil.copytree(true, work / "room")
        changed = [spoil(rng, work / "room") for _ in range(rng.choice([1, 1, 2, 3]))]
        used(rng, work, any(changed))


def records(rng, folder):
    """Records of another form, with right checksums."""
    true, _ = made()
    with nothing_left(folder) as work:
        out = Path(shutil.copytree(true, work / "room"))
        for path in rng.sample(sorted([*out.glob("*.truth.json"), *out.glob("*.layout.json")]), 2):
            text = path.read_text(encoding="utf-8")
            for _ in range(rng.choice([1, 1, 3])):
                text = text_changed(rng, text)
            listed(out, write(path, text))
        used(rng, work, changed=True)


NAMES = [*YAML, "]]>", 'a"b', "x: y", "</script>", "a.b", "\ud800", "\u202e", "日本"]


def names(rng, folder):
    """Keys, splits, classes and cameras of any name are refused, or come out as they went in."""
    key, split, name = ((rng.choice(NAMES) if rng.random() < 0.5 else "room") for _ in range(3))
    with nothing_left(folder) as work:
        try:
            with dataset.Writer("room", classes={"rules": [{"match": "*", "class": name}]}) as writer:
                writer.add(key, picture(), split=split)
        except OmniscvError as error:
            clear(error)
            return
        require(dataset.check("room", deep=True) == [], "a dataset as it was made has faults")
        (frame,) = dataset.open("room")
        require((frame.key, frame.split, [*frame.classes.classes]) == (key, split, [name]), "other names")
        for format in FORMATS:
            with contextlib.suppress(OmniscvError):
                dataset.export("room", format, work / format)
        if (coco := work / "coco" / "annotations.json").exists():
            said = json.loads(coco.read_text(encoding="utf-8"))
            require(said["categories"][0]["name"] == name, "another class in COCO")
        ran(["look", "room", "--out", "page.html"])


picture = cache(lambda: image(width=8))


def shards(rng, folder):
    """Shards that are damaged, or packed by others, give the samples that were packed, or are refused."""
    true = rng.choice(stores())
    with nothing_left(folder) as work:
        shutil.copytree(true / "exports" / "webdataset", work / "shards")
        listing = work / "shards" / "shards.json"
        path = rng.choice(sorted(listing.parent.iterdir()))
        if rng.random() < 0.2 or path.suffix == ".json":
            spoil_file(rng, path)
        else:
            path.write_bytes(rng.choice([bytes_changed, header_changed, repacked])(rng, path.read_bytes()))
            said = json.loads(listing.read_bytes())
            for shard in said["shards"]:
                shard["bytes"] = (listing.parent / shard["path"]).stat().st_size
            listing.write_text(json.dumps(said), encoding="utf-8")
        (scratch := work / "scratch").mkdir()
        try:
            manifest, of_shard = read_list(storage.folder(work / "shards"))
            for file, keys in of_shard.items():
                with closing(Shard(storage.folder(work / "shards"), file, manifest)) as shard:
                    for key in keys:
                        dict(contents([shard.extract(key, ("lit", "depth", "labels", "truth"), scratch)]))
        except OmniscvError as error:
            clear(error)


def header_changed(rng, data):
    """A tar with another byte in a member's header: its type, its size, a checksum."""
    data = bytearray(data)
    start = 512 * rng.randrange(len(data) // 512)
    at = start + rng.choice([0, 124, 130, 135, 156, 157, 257, 345])
    data[at] = rng.choice([0, 0x30, 0x31, 0x32, 0x35, 0x36, 0x4C, 0x53, 0x78, 0x80, 0xFF])
    head = bytes(data[start : start + 148]) + b" " * 8 + bytes(data[start + 156 : start + 512])
    data[start + 148 : start + 156] = b"%06o\0 " % sum(head)
    return bytes(data)


def repacked(rng, data):
    """The members of a tar packed again, one of them as something else."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(data)) as tar, tarfile.open(fileobj=packed, mode="w") as new:
        members = [(member, tar.extractfile(member).read()) for member in tar]
        chosen = rng.choice(members)[0]
        for member, content in members:
            if member is chosen:
                kind = rng.randrange(4)
                if kind == 0:
                    member.type = rng.choice([tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, b"5"])
                    member.linkname = rng.choice([member.name, members[0][0].name, "/etc/passwd", "../x"])
                    member.size = 0
                    content = b""
                elif kind == 1:
                    member.name = rng.choice(["../x", "/etc/x", members[0][0].name, "x" * 300, "a\nb", "."])
                else:
                    content = text_changed(rng, content.decode(errors="replace")).encode("utf-8", "replace")
                    member.size = len(content)
            new.addfile(member, io.BytesIO(content))
    return packed.getvalue()
