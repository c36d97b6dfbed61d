"""Small datasets to test with."""

import hashlib
import json
from dataclasses import asdict, replace

import omniscv
from omniscv.frame import FileEntry
from omniscv.job import load
from omniscv.make import make

CLASSES = """
taxonomy: nyu40
rules:
  - {match: "Layout_Wall_*", class: wall, stuff: true}
  - {match: "Layout_Floor", class: floor, stuff: true}
  - {match: "Layout_Ceiling", class: ceiling, stuff: true}
  - {regex: "Chair_[0-9]+", class: chair, supercategory: furniture}
  - {match: "Door*", class: door}
unmatched: other
"""

JOB = """
source: {source}
cameras:
  pano: {{model: equirectangular, width: 48, height: 24}}
  lens: {{model: fisheye-equidistant, width: 32, height: 32, fov_deg: 180}}
poses:
  - {{position: [0, 0, 1.5], place: middle, time: 0}}
  - {{position: [0.5, 0.2, 1.5], yaw_deg: 40, place: middle, time: 0.5}}
  - {{position: [-1.2, 0.5, 1.2], place: corner, time: 1}}
modes: [lit, object_mask, depth, normals]
face_size: 32
classes: classes.yaml
split: {{train: 0.5, val: 0.5, seed: 1}}
out: {out}
"""


def job_file(folder, source="scene://four-wall", out="dataset", more=""):
    """Write a job and its classes into a folder; return the job's path."""
    (folder / "classes.yaml").write_text(CLASSES, encoding="utf-8")
    path = folder / f"{out}.yaml"
    path.write_text(JOB.format(source=source, out=out) + more, encoding="utf-8")
    return path


def made(folder, **job):
    wanted = load(job_file(folder, **job))
    make(wanted)
    return wanted.out


def first_of(job, count):
    """The job without its further poses."""
    known = {"times_ns": job.times_ns and job.times_ns[:count], "places": job.places and job.places[:count]}
    return replace(job, poses=job.poses[:count], **known)


def tree(folder):
    """Every file below a folder, hidden ones too, with a digest of its bytes."""
    return {
        str(path.relative_to(folder)): hashlib.md5(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def enter(out, key, kind, name=None):
    """List a file of a frame as it is now, with its size and checksum, in ``frames.jsonl`` and beside it."""
    own = out / f"{key}.json"
    stored = json.loads(own.read_bytes())
    files = stored["frame"]["files"]
    files[kind] = asdict(FileEntry.of(out / (name or files[kind]["path"])))
    own.write_text(json.dumps(stored, indent=2) + "\n", encoding="utf-8")

    def change(line):
        return {**line, "files": {**line["files"], kind: files[kind], "image": asdict(FileEntry.of(own))}}

    relisted(out, lambda lines: [change(line) if line["key"] == key else line for line in lines])


def relisted(out, change):
    path = out / "frames.jsonl"
    lines = change([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()])
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")


def image(source="scene://four-wall", position=(0, 0, 1.5), width=32, modes=("lit", "object_mask")):
    camera = omniscv.cameras.create("equirectangular", width=width, height=width // 2)
    with omniscv.open_source(source) as opened:
        return omniscv.render(camera, omniscv.Pose.from_angles(position), opened, modes, face_size=32)
