"""``omniscv dataset``: make, export, check, pack and describe datasets."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Exit, Option, Typer

from omniscv.cli import console
from omniscv.cli.console import Display, StyleOption, display
from omniscv.cli.options import IMAGES, AsJson, JobArguments, setting, with_blocks, with_job
from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from omniscv.job import Job
    from omniscv.make import Made

_HELP = "Images with all their truth, as files that other programs read."
app = Typer(name="dataset", help=_HELP, no_args_is_help=True, add_completion=False)

# Texts: as a path, a URL would lose a slash.
Dataset = Annotated[str, Argument(metavar="DIR", help="A dataset, by path or URL.")]
Out = Annotated[str | None, Option(help="The folder or URL to write into; else exports/FORMAT in DIR.")]
Cameras = Annotated[list[str] | None, Option("--camera", help="Only frames of this camera; repeatable.")]
Settings = Annotated[
    list[str] | None, Option("--set", help="KEY=VALUE: an option of the format, such as max_count=100.")
]
_CLUSTER_HELP = "Workers of Dask: local:N processes here, or a scheduler's address."


@dataclass(frozen=True)
class _Made:
    """Options of how a dataset is made."""

    resume: Annotated[
        bool, Option("--resume", help="Complete an existing dataset of the same job; so it does without.")
    ] = False
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an existing dataset.")] = False
    keep_going: Annotated[
        bool, Option("--keep-going", help="Report frames that fail, and leave them out.")
    ] = False
    shard: Annotated[
        str | None, Option(help="I/N: part I of N only, I from 0; N is of all parts, not of those that run.")
    ] = None
    limit: Annotated[
        int | None, Option(min=1, help="So many frames only, spread over worlds and poses by a hash.")
    ] = None
    cluster: Annotated[str | None, Option(help=_CLUSTER_HELP)] = None
    patience: Annotated[
        float | None,
        Option(help="Seconds without workers, or news of them, until a cluster's run ends; 600."),
    ] = None
    workers: Annotated[int, Option(min=1, max=256, help="Images composed at a time.")] = 1

    def part(self) -> tuple[int, int] | None:
        """Return ``--shard`` as numbers, after refusing options that exclude each other."""
        if self.cluster is not None and (self.shard or self.workers != 1 or self.overwrite):
            others = "--shard, --workers and --overwrite"
            raise ArgumentError(f"--cluster: expected it without {others}, got several of them")
        if self.patience is not None and self.cluster is None:
            raise ArgumentError("--patience: expected it with --cluster, got it alone")
        if self.overwrite and (self.resume or self.shard):
            raise ArgumentError("--overwrite: expected it without --resume and --shard, got several of them")
        if self.shard is None:
            return None
        index, _, count = self.shard.partition("/")
        if not (index.isdecimal() and count.isdecimal() and int(index) < int(count)):
            wanted = "expected I/N with I from 0 to N - 1, such as 0/4"
            raise ArgumentError(f"--shard: {wanted}, got {self.shard!r}")
        return int(index), int(count)


@app.command(epilog="Example: omniscv dataset make dataset.yaml --workers 2")
@with_job(IMAGES, needs_file=True)
@with_blocks
def make(job: JobArguments, how: _Made, progress: StyleOption = None) -> None:
    """Make a dataset: images, labels, classes, truths, the manifest and exports.

    The same job gives the same bytes, whatever the workers, shards, clusters and interruptions. If it was
    stopped, the same command goes on. A dataset of another job is refused.
    """
    from omniscv.cli.remedies import go_on
    from omniscv.job import FailureLimit
    from omniscv.make import make as make_dataset

    if how.cluster is not None and job.file is not None:  # workers may be in another folder
        job = replace(job, file=job.file.absolute())
    loaded = job.load()
    part = how.part()
    if how.keep_going:
        loaded = replace(loaded, failures=FailureLimit(1.0))
    existing: Literal["resume", "replace"] = "replace" if how.overwrite else "resume"
    with display("frames", progress) as show:
        if how.cluster is not None:
            result = _make_on_workers(loaded, how, show)
        else:
            result = make_dataset(
                loaded,
                existing=existing,
                shard=part,
                limit=how.limit,
                workers=how.workers,
                progress=show,
                warn=console.error,
            )
    state = "complete"
    if result.missing:
        whole = go_on(job.typed, without=("--shard",))
        state = f"{result.missing} frames of other shards are missing: after them this finishes: {whole}"
    failed = f", {result.failed} failed" if result.failed else ""
    console.line(f"{loaded.out}: {result.written} frames made, {result.kept} kept{failed}; {state}")
    if result.failed:
        console.error(f"this tries the frames that failed again: {go_on(job.typed)}")
    raise Exit(1 if result.failed and how.keep_going else 0)


def _make_on_workers(job: Job, how: _Made, show: Display) -> Made:
    """Make a dataset on the workers of ``--cluster``."""
    from omniscv.arguments import number
    from omniscv.cluster import PATIENCE_S, Progress, make, workers_of

    assert how.cluster is not None
    started = time.monotonic()

    def progress(now: Progress) -> None:
        minutes = max(time.monotonic() - started, 1.0) / 60
        rate = f"{now.frames / minutes:.3g} a minute"
        workers = f"{now.workers} worker{'' if now.workers == 1 else 's'}"
        show.note = f"parts {now.parts}/{now.of_parts}, {rate}, {workers}"
        show.steps(now.frames, now.of_frames)

    return make(
        job,
        workers_of(how.cluster),
        limit=how.limit,
        patience_s=PATIENCE_S if how.patience is None else number("--patience", how.patience, above=0),
        progress=progress,
        warn=console.error,
        note=console.line,
    )


@app.command(epilog="Example: omniscv dataset export dataset --to webdataset --set max_count=100")
def export(
    folder: Dataset,
    to: Annotated[str, Option(help="A format.")],
    out: Out = None,
    camera: Cameras = None,
    settings: Settings = None,
) -> None:
    """Write a dataset in the form of another program, without its source."""
    from omniscv.dataset import export

    values = dict(setting(text, "max_count=100") for text in settings or [])
    for path in export(folder, to, out, camera or (), **values):
        console.line(path)


@app.command(epilog="Example: omniscv dataset check dataset --deep")
def check(
    folder: Dataset,
    format: Annotated[str | None, Option(help="Check an export to a format too.")] = None,
    deep: Annotated[bool, Option("--deep", help="Read all layers, records and exports.")] = False,
    pictures: Annotated[
        bool, Option("--pictures", help="Ask images with depth whether poses, also of exports, are theirs.")
    ] = False,
) -> None:
    """Check a dataset against its manifest: one line for each fault. Exit code 1 if there is any."""
    from omniscv.dataset import check, open
    from omniscv.storage import without_secrets

    faults = check(folder, deep=deep, format=format)
    for fault in faults:
        console.line(fault)
    if pictures and not faults:
        from omniscv.diagnostics.exported_poses import check_pictures

        for line, is_wrong in check_pictures(folder, format):
            console.line(line)
            if is_wrong:
                faults.append(line)
    if not faults:
        console.line(f"{without_secrets(folder)}: {len(open(folder))} frames, no faults")
    raise Exit(1 if faults else 0)


@app.command(epilog="Example: omniscv dataset info dataset")
def info(folder: Dataset, as_json: AsJson = False) -> None:
    """Count the frames, cameras, splits, objects, classes and bytes of a dataset."""
    from omniscv.dataset.checking import info

    if as_json:
        console.as_json(info(folder))
    else:
        console.summary(info(folder))


@app.command(epilog="Example: omniscv dataset card dataset --name Rooms --license CC-BY-4.0")
def card(
    folder: Annotated[Path, Argument(metavar="DIR", help="A dataset in a folder.")],
    name: Annotated[str | None, Option(help="Of the dataset; else the folder's.")] = None,
    license: Annotated[
        str | None, Option(help="An identifier of SPDX, such as CC-BY-4.0; unknown if not given.")
    ] = None,
    creator: Annotated[str, Option(help="A person or group.")] = "",
    url: Annotated[str, Option(help="Where it is published.")] = "",
) -> None:
    """Write what strangers and archives read: README.md, croissant.json, codemeta.json, .zenodo.json."""
    from omniscv.dataset.card import UNKNOWN, About, write_card

    about = About(name or folder.resolve().name, license or UNKNOWN, creator, url)
    for path in write_card(folder, about):
        console.line(str(path))
    if license is None:
        console.error("the card says that the licence is unknown; --license states one")


@app.command(epilog="Example: omniscv dataset classes scene://four-wall classes.yaml")
def classes(
    scene: Annotated[
        str, Argument(metavar="SCENE", help="A scene, the address of a source, a recording, or a dataset.")
    ],
    file: Annotated[Path, Argument(metavar="CLASSES.yaml", help="The rules; see docs/datasets.md.")],
) -> None:
    """List the class of every object. Exit code 1 if an object has none and the rules make that an error."""
    from omniscv.frame.classes import class_rules

    rules = class_rules(file)
    class_of = {}
    rows: list[tuple[object, ...]] = []
    for name in object_names(scene):
        label = rules.class_of(name)
        class_of[name] = label
        if label in rules.classes:
            rows.append((name, label, rules.classes[label].id))
        else:
            rows.append((name, label or f"({rules.unmatched})", ""))
    console.table(("object", "class", "id"), rows)
    rules.table(class_of)


def object_names(scene: str) -> tuple[str, ...]:
    """Return the names of the objects of a scene, of a source by its address, or of a dataset, sorted.

    Raises:
        ArgumentError: another address.
        SourceError, RecordingError: the source cannot be opened.
    """
    from omniscv.dataset import manifest
    from omniscv.sources.registry import open_source, scheme_of
    from omniscv.storage import SCHEMES, folder

    scheme = scheme_of(scene)
    path = Path(scene)
    if scheme in (None, *SCHEMES) and folder(scene).exists(manifest.DATASET):
        return tuple(sorted(manifest.read(scene).names))
    is_recording = path.exists() and path.suffix not in (".yaml", ".yml", ".json")
    with open_source(scene if scheme or is_recording else f"scene://{scene}") as source:
        return tuple(source.objects().names())


@app.command(epilog="Example: omniscv dataset pack dataset --as webdataset")
def pack(
    folder: Dataset,
    as_: Annotated[str, Option("--as", help="webdataset.")] = "webdataset",
    out: Out = None,
    camera: Cameras = None,
    settings: Settings = None,
) -> None:
    """Write a dataset for training: WebDataset shards."""
    from omniscv.arguments import one_of
    from omniscv.dataset.exporting import get

    export(folder, one_of("--as", get(as_).name, ("webdataset",)), out, camera, settings)


@app.command(epilog="Example: omniscv dataset video dataset --camera panorama --out panorama.mp4 --rate 10")
def video(
    folder: Dataset,
    out: Annotated[str, Option(help="The MP4 file, by path or URL.")],
    camera: Annotated[str | None, Option(help="The camera, of several.")] = None,
    rate: Annotated[float, Option(help="Frames a second.")] = 30.0,
    progress: StyleOption = None,
) -> None:
    """Write the colour of a camera's frames as a video; players show panoramas as spheres."""
    from omniscv.arguments import one_of
    from omniscv.dataset import open
    from omniscv.dataset.media import write_video
    from omniscv.storage import without_secrets

    frames = list(open(folder))
    if camera is not None:
        one_of("--camera", camera, sorted({frame.camera_name for frame in frames}))
        frames = [frame for frame in frames if frame.camera_name == camera]
    with display("frames", progress) as show:
        written = write_video(frames, out, rate=rate, progress=show.steps)
    console.line(without_secrets(written))
