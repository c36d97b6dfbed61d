"""A dataset is of one job: others are refused by the first difference, mixtures made by hand are found."""

import json
import re
import shutil
from dataclasses import replace

import pytest
from support.datasets import image, relisted, tree

import mock_server
from omniscv import Pose, cameras, dataset, open_source, record, storage
from omniscv.cli import run
from omniscv.compose.files import versions
from omniscv.dataset import exporting, manifest
from omniscv.dataset.origin import Origin
from omniscv.errors import ArgumentError, DatasetError, RecordingError, SourceError
from omniscv.frame import FileEntry
from omniscv.importing.folders import import_folder
from omniscv.job import load
from omniscv.make import Part, finish, make, run_part
from omniscv.make.frames import FrameMaker
from omniscv.sources import Request, View

JOB = """
source: {source}
cameras: {{pano: {{model: equirectangular, width: 32, height: 16}}}}
poses: {poses}
modes: [lit, object_mask, depth]
face_size: 16
out: {out}
"""
PLACES = ("0, 0, 1.5", "0.2, 0, 1.5", "-1.2, 0.5, 1.2", "1, -1, 1.2")
SPLIT = "split: {train: 0.5, test: 0.5, distance_m: 0.5, seed: 3}\n"
CLASSES = "classes: {rules: [{match: '*', class: thing}]}\n"


def at(*places):
    return "[{}]".format(", ".join(f"{{position: [{place}]}}" for place in places))


def drawn(seed):
    return f"{{random: {{count: 4, low: [-1, -1, 1.2], high: [1, 1, 1.8], clearance: 0.2, seed: {seed}}}}}"


@pytest.fixture
def job(tmp_path):
    """A function that returns a job of four small images."""

    def write(more="", source="scene://four-wall", poses=None, out="made"):
        path = tmp_path / f"{out}.yaml"
        text = JOB.format(source=json.dumps(source), poses=poses or at(*PLACES), out=out)
        path.write_text(text + more, encoding="utf-8")
        return load(path)

    return write


OTHERS = {
    "transfer": ({"more": "source_options: {transfer: srgb}\n"}, "source_options.transfer is None"),
    "address": ({"source": "mock://four-wall"}, "source.scheme is 'scene', in the job 'mock'"),
    "world": ({"source": "scene://six-wall"}, "source.name is 'four-wall', in the job 'six-wall'"),
    "fewer": ({"poses": at(*PLACES[:2])}, "frame pano-2 is none of the 2 of the job"),
    "renumbered": (
        {"poses": at(*(f"{0.1 * i}, 0, 1.5" for i in range(11)))},
        "frame pano-0 is none of the 11 of the job",
    ),
    "moved": ({"poses": at(PLACES[0], "0.3, 0, 1.5", *PLACES[2:])}, "frame pano-1 has pose"),
    "classes": ({"more": CLASSES}, "frames have no classes, in the job classes"),
    "split": ({"more": SPLIT}, "splits is None, in the job"),
    "watch": ({"more": "watch: mark\n"}, "options.watch is None, in the job 'mark'"),
    "option": ({"more": "filter: nearest\n"}, "options.filter is 'auto', in the job 'nearest'"),
    "truth": ({"more": "truth: {boxes: true}\n"}, "options.truth.boxes is None, in the job {}"),
    "sensor": ({"more": "sensor: {seed: 4}\n"}, "options.sensor is None"),
    "format": ({"more": "image_format: jpg\n"}, "options.image_format is 'png', in the job 'jpg'"),
}


@pytest.mark.parametrize(("other", "says"), OTHERS.values(), ids=OTHERS)
def test_another_job_is_refused_by_the_first_difference(other, says, job):
    made = job()
    make(made)
    complete = tree(made.out)
    for state in ("complete", "interrupted"):
        if state == "interrupted":
            for path in [made.out / "frames.jsonl", *made.out.glob("pano-3.*")]:
                path.unlink()
        before = tree(made.out)
        for shard in (None, (0, 2)):
            with pytest.raises(ArgumentError, match=re.escape(says)):
                make(job(**other), existing="resume", shard=shard)
        assert tree(made.out) == before
    make(job(), existing="resume")
    assert tree(made.out) == complete


def test_what_may_differ_gives_the_bytes_of_a_fresh_run(job, tmp_path):
    make(job(poses=at(*PLACES[:2]), more="export: [coco]\n" + SPLIT))
    more = SPLIT + "export: [ply]\nfailures: {skip: 0.5}\nrecord: room.sqlite\n"
    done = make(job(more=more), existing="resume", workers=2)
    assert (done.written, done.kept) == (2, 2)
    make(job(more=SPLIT + "export: [ply]\n", out="fresh"))
    assert tree(tmp_path / "made") == tree(tmp_path / "fresh")


def test_a_world_is_known_by_its_content(job, tmp_path):
    scene = tmp_path / "room.yaml"
    text = "room: {floor: [[-3, -2], [3, -2], [3, 2], [-3, 2]], height: 2.5}\nobjects: {}\n"
    scene.write_text(text)
    for scheme in ("scene", "mock"):
        made = job(source=f"{scheme}://{scene}", out=scheme, more=f"record: {scheme}.sqlite\n")
        make(made)
        scene.write_text(text.replace("2.5", "2.4"))
        before = tree(made.out)
        with pytest.raises(ArgumentError, match="world is '"):
            make(replace(made, record=None), existing="resume")
        with pytest.raises(
            ArgumentError, match=r"sqlite: expected a recording of the same captures; its world"
        ):
            make(replace(made, out=tmp_path / "other"))
        assert tree(made.out) == before
        scene.write_text(text)


def test_a_recording_is_of_one_source(job, tmp_path, capsys):
    text = "record: room.sqlite\nsource_options: {{exposure: {}}}\n"
    first = job(source="mock://four-wall?dialect=N2", more=text.format("1.0"))
    make(first)
    other = job(source="mock://four-wall?dialect=N2", more=text.format("2.0"), out="other")
    before = (tmp_path / "room.sqlite").read_bytes()
    for command in (["render"], ["record"], ["dataset", "make"]):
        assert run([*command, str(tmp_path / "other.yaml")]) == 2
        assert "its source_options.exposure is 1.0, in the job 2.0; record into" in capsys.readouterr().err
    assert (tmp_path / "room.sqlite").read_bytes() == before
    assert other.out.exists() is False


def test_a_recording_is_of_one_dialect(job, tmp_path, capsys):
    """Also where nobody says what is recorded, as in a program."""
    view = View(Pose.from_angles((0, 0, 1.5)), 90.0, 16, 16)
    address = "mock://four-wall?size=16x16&dialect"
    with (
        open_source(f"{address}=N3") as live,
        record(live, tmp_path / "r") as source,
    ):
        list(source.capture([Request(view, "lit")]))
    turned = View(Pose.from_angles((0, 0, 1.5), 90), 90.0, 16, 16)
    with (
        open_source(f"{address}=0.3.10") as live,
        record(live, tmp_path / "r") as source,
        pytest.raises(RecordingError, match=r"expected captures of dialect N3, as those in it, got 0\.3\.10"),
    ):
        list(source.capture([Request(turned, "lit")]))


def test_an_import_does_not_replace_other_captures(tmp_path, capsys):
    for scene, name in (("four-wall", "first"), ("six-wall", "second")):
        made = ["record", "--source", f"scene://{scene}", "--modes", "lit", "--set", "face_size=16"]
        assert run([*made, "--out", str(tmp_path / f"{name}.sqlite")]) == 0
        assert run(["recording", "export", str(tmp_path / f"{name}.sqlite"), str(tmp_path / name)]) == 0
        (tmp_path / name / "scene.json").unlink(missing_ok=True)
    path = tmp_path / "room.sqlite"
    assert import_folder(tmp_path / "first", path) == 6
    assert import_folder(tmp_path / "first", path) == 6  # the same captures again
    before = path.read_bytes()
    for entry in (index := json.loads((tmp_path / "second" / "captures.json").read_text())):
        entry["provenance"].pop("scene", None)
    (tmp_path / "second" / "captures.json").write_text(json.dumps(index))
    with pytest.raises(RecordingError, match="expected the lit that was recorded before"):
        import_folder(tmp_path / "second", path)
    assert path.read_bytes() == before


def test_a_job_with_another_seed_of_poses_is_refused(job):
    make(job(poses=drawn(1)))
    with pytest.raises(ArgumentError, match=r"sampling.RandomPoses.seed is 1, in the job 2"):
        make(job(poses=drawn(2)), existing="resume")


def test_appended_poses_that_join_two_places_are_refused(job):
    """The frames of one would move to another split."""
    apart = ("0, 0, 1.5", "0.8, 0, 1.5")
    make(job(poses=at(*apart), more=SPLIT))
    with pytest.raises(
        ArgumentError, match=r"frame pano-1 has place '0\.800,0\.000,1\.500', in the job '0\.000"
    ):
        make(job(poses=at(*apart, "0.4, 0, 1.5"), more=SPLIT), existing="resume")


def test_a_job_that_another_has_begun_is_refused(job, monkeypatch):
    """Also before the first frame is there, as long as the other one is alive."""
    first = job()
    second = job(poses=at(*PLACES[:3], "1, 1, 1.2"), out="made")
    maker = FrameMaker.run

    def run_while_another_begins(*args):
        with pytest.raises(ArgumentError, match="frame pano-3 has pose"):
            make(second, existing="resume")
        return maker(*args)

    with monkeypatch.context() as patch:
        patch.setattr(FrameMaker, "run", run_while_another_begins)
        make(first)
    assert dataset.check(first.out, deep=True) == []


def fails(*_):
    raise SourceError("expected a calm sea")


def test_a_pose_that_failed_may_be_moved(job, monkeypatch):
    """Nothing was made of it."""
    with monkeypatch.context() as patch:
        patch.setattr(FrameMaker, "run", fails)
        with pytest.raises(SourceError):
            make(job())
    assert make(job(poses=at(*PLACES[:3], "1, 1, 1.2")), existing="resume").written == 4


def test_parts_of_two_jobs_are_refused(job):
    """In one folder, or copied into one."""
    first = job(poses=drawn(1))
    second = job(poses=drawn(2), out="second")
    run_part(first, Part(0, 2))
    with pytest.raises(ArgumentError, match="seed is 1, in the job 2"):
        run_part(replace(second, out=first.out), Part(1, 2))
    run_part(second, Part(1, 2))
    shutil.copytree(first.out, second.out, dirs_exist_ok=True)
    with pytest.raises(DatasetError, match=r"parts/1-of-2\.json: expected a part of this dataset"):
        finish(replace(first, out=second.out), 2)
    with pytest.raises(ArgumentError, match=r"is one of another job or source|has pose"):
        make(replace(first, out=second.out), existing="resume")


def made_by(out, version):
    """Let a manifest say that another version has begun it."""
    whole = manifest.read(out)
    older = {**whole.versions, "omniscv": version}
    origin = Origin(whole.origin.worlds, (older,))
    manifest.write(storage.folder(out), replace(whole, versions=older, origin=origin))


def test_parts_of_two_versions_are_refused(job):
    run_part(job(), Part(0, 2))
    made_by(job().out, "0.1.0")
    with pytest.raises(ArgumentError, match=r"parts are made with omniscv 0\.1\.0, this one with"):
        run_part(job(), Part(1, 2))


def test_every_version_of_a_run_is_listed(job):
    make(job(poses=at(*PLACES[:2])))
    made_by(job().out, "0.1.0")
    make(job(), existing="resume")
    runs = manifest.read(job().out).origin.runs
    assert [run["omniscv"] for run in runs] == ["0.1.0", versions()["omniscv"]]


def test_a_frame_that_fails_when_it_is_made_again_is_no_more_listed(job, monkeypatch):
    made = job(more="failures: {skip: 0.5}\n")
    make(made)
    (made.out / "pano-1.lit.png").write_bytes(b"damaged")

    def fail(self, composed):
        with self._failures.leaving_out([composed[0]], ""):
            raise SourceError("expected a calm sea")

    with monkeypatch.context() as patch:
        patch.setattr(FrameMaker, "_save", fail)
        assert make(made, existing="resume").failed == 1
    assert [frame.key for frame in dataset.open(made.out)] == ["pano-0", "pano-2", "pano-3"]
    assert [line["key"] for line in manifest.read_failed(made.out)] == ["pano-1"]
    assert not list(made.out.glob("pano-1.*"))
    assert dataset.check(made.out, deep=True) == []
    assert make(made, existing="resume").written == 1


def test_marked_frames_are_kept(job):
    made = job(more="watch: mark\n")
    make(made)
    mark = {"watch": ["Ball"]}
    own = made.out / "pano-1.json"
    stored = json.loads(own.read_bytes())
    stored["frame"] |= mark
    own.write_text(json.dumps(stored))
    entry = FileEntry.of(own)
    relisted(
        made.out,
        lambda lines: [
            {**line, **mark, "files": {**line["files"], "image": vars(entry)}}
            if line["key"] == "pano-1"
            else line
            for line in lines
        ],
    )
    assert make(made, existing="resume").written == 0
    assert dataset.open(made.out)[1].watch == ("Ball",)


# -- writers ---------------------------------------------------------------------------------------------


def shown_names(labels, name_of):
    return {name_of[label] for label in set(labels.ravel().tolist()) - {0}}


def test_two_writers_at_once_agree_on_names_and_cameras(tmp_path):
    lenses = [cameras.create("fisheye-equidistant", 16, 16, fov_deg=fov) for fov in (120, 140)]
    shown = [image(source=f"scene://{world}") for world in ("four-wall", "six-wall")]
    with dataset.Writer(tmp_path) as first, dataset.Writer(tmp_path, resume=True) as second:
        for i, writer in enumerate((first, second)):
            small = {"lit": shown[i].lit[:, :16]}
            writer.add(f"labels-{i}", shown[i])
            writer.add(
                f"lens-{i}", replace(shown[i], camera=lenses[i], layers=small, valid=shown[i].valid[:, :16])
            )
    assert dataset.check(tmp_path) == []
    frames = {frame.key: frame for frame in dataset.open(tmp_path)}
    for i, picture in enumerate(shown):
        frame = frames[f"labels-{i}"]
        assert frames[f"lens-{i}"].camera == lenses[i]
        names = {number: name for name, number in frame.instances.items()}
        known = dict(enumerate(picture.objects.names(), start=1))
        assert shown_names(frame.layer("labels"), names) == shown_names(picture.labels, known)


def test_a_writer_does_not_replace_a_frame_by_another(tmp_path):
    with dataset.Writer(tmp_path) as writer:
        writer.add("a", image())
    with (
        dataset.Writer(tmp_path, resume=True) as writer,
        pytest.raises(ArgumentError, match="got 'a' again, with other values"),
    ):
        writer.add("a", image(position=(1, 0, 1.5)))


def test_a_writer_adds_to_a_job_only_images_as_the_job_makes_them(job):
    make(job())
    with (
        dataset.Writer(job().out, resume=True) as writer,
        pytest.raises(ArgumentError, match="expected an image as the job of the dataset makes them; its opt"),
    ):
        writer.add("more", image())


# -- exports ---------------------------------------------------------------------------------------------


def names_in(out):
    return sorted(
        picture["file_name"] for picture in json.loads((out / "annotations.json").read_text())["images"]
    )


def test_exports_follow_their_frames(job):
    """Those of the job, those that somebody made by hand; those that the job has no more go."""
    few = job(poses=at(*PLACES[:2]), more="export: [coco, {format: ply, out: points}]\n")
    make(few)
    dataset.export(few.out, "coco", cameras=["pano"])  # also by hand, in place of the job's
    dataset.export(few.out, "yolo")
    make(job(more="export: [coco]\n"), existing="resume")
    assert len(names_in(few.out / "exports" / "coco")) == 4
    assert len(list((few.out / "exports" / "yolo").rglob("pano-*.txt"))) == 4
    assert not (few.out / "exports" / "points").exists()
    assert dataset.check(few.out, deep=True) == []


def test_stale_exports_are_named(job):
    made = job(more="export: [coco]\n")
    make(made)
    relisted(made.out, lambda lines: lines[:3])
    for path in made.out.glob("pano-3.*"):
        path.unlink()
    faults = dataset.check(made.out)
    assert "exports/coco: expected an export of these frames, got one of others; export it again" in faults


def test_an_export_that_cannot_be_made_again_is_a_fault_among_others(job, monkeypatch):
    made = job(more="export: [coco]\n")
    make(made)

    def fail(self, frames, out, options):
        raise ArgumentError("expected a calm sea")

    coco = exporting.get("coco")
    monkeypatch.setattr(type(coco), "write", fail)
    faults = dataset.check(made.out, deep=True)
    assert faults == [
        "exports/coco: expected frames that it can be made of again, got: coco: expected a calm sea"
    ]


# -- mixtures made by hand -------------------------------------------------------------------------------


def mix(into, other, keys):
    """Copy frames of another dataset over those of their keys, files and lines."""
    lines = {line["key"]: line for line in map(json.loads, (other / "frames.jsonl").read_text().splitlines())}
    for key in keys:
        for path in into.glob(f"{key}.*"):
            path.unlink()
        for path in other.glob(f"{key}.*"):
            shutil.copy(path, into)

    def change(before):
        kept = [line for line in before if line["key"] not in keys]
        return sorted([*kept, *(lines[key] for key in keys)], key=lambda line: line["key"])

    relisted(into, change)


JOIN = "expected a frame of what dataset.json says that the dataset is made of, got one of another job"
MIXTURES = {
    "exposures": ({"more": "source_options: {transfer: srgb}\n"}, ["pano-1"], JOIN),
    "seeds": ({"more": "sensor: {seed: 4}\n"}, ["pano-1"], JOIN),
    "worlds": ({"source": "scene://six-wall"}, ["pano-1"], "frames of several worlds are mixed"),
    "formats": (
        {"more": "image_format: jpg\n"},
        ["pano-1"],
        "expected a .png file, as pano-0 has, got a .jpg",
    ),
    "classes": ({"more": CLASSES}, ["pano-1"], "expected no classes, as the dataset has none"),
    "numbers": (
        {"poses": at(*(f"{0.1 * i}, 0, 1.5" for i in range(11)))},
        ["pano-05"],
        "pano-05: expected as many digits as pano-0 has: frames of several jobs",
    ),
    "more poses": ({"poses": at(*PLACES, "1, 1, 1.2")}, ["pano-4"], "expected one of the 4 poses of the job"),
}


@pytest.mark.parametrize(("other", "keys", "says"), MIXTURES.values(), ids=MIXTURES)
def test_a_mixture_is_found(other, keys, says, job):
    first = job()
    second = job(**other, out="second")
    make(first)
    make(second)
    assert dataset.check(second.out, deep=True) == []
    mix(first.out, second.out, keys)
    faults = dataset.check(first.out)
    assert any(says in fault for fault in faults), faults


def test_splits_that_are_too_near_are_found(job):
    made = job(more=SPLIT)
    make(made)

    def change(lines):
        for i, line in enumerate(lines):
            line["place"] = f"{line['pose']['position'][0]:.3f},0.000,1.500"
            line["split"] = "train" if i else "test"
        return lines

    relisted(made.out, change)
    says = "expected places 0.5 m apart in different splits, got 0.2 m"
    assert any(says in fault for fault in dataset.check(made.out))


# -- worlds that are frozen ------------------------------------------------------------------------------


@pytest.mark.parametrize("shards", [(None, None), ((0, 2), (1, 2))], ids=["resumed", "shards"])
def test_a_world_that_is_frozen_is_so_at_one_instant(shards, job):
    with mock_server.serve("workshop") as server:
        first = job(source=server.uri, poses=at(*PLACES[:1]), more="freeze: pause\n")
        whole = job(source=server.uri, poses=at("0, 0, 1.5", "0.2, 0, 1.5"), more="freeze: pause\n")
        make(first if shards[0] is None else whole, shard=shards[0])
        with open_source(server.uri) as source:  # the world goes on
            for _ in range(5):
                list(source.capture([Request(View(Pose.from_angles((0, 0, 1.5)), 90.0, 16, 16), "lit")]))
        with pytest.raises(ArgumentError, match=r"frozen is '.*', in the job '"):
            make(whole, existing="resume", shard=shards[1])
