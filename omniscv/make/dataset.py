"""Make the dataset that a job describes, at once or part by part.

A part is a run of consecutive poses, which any process makes into the same bytes. Its last file is its
marker, ``parts/INDEX-of-COUNT.json``: its frames with their checksums. A dataset is finished by joining the
markers of all its parts into ``frames.jsonl``. Then they are removed, so that a dataset has the same files
however it was made.
"""

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import astuple, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from omniscv import modalities, storage
from omniscv.arguments import whole_number
from omniscv.compose.files import versions
from omniscv.compose.renderer import Renderer
from omniscv.dataset import exported, manifest
from omniscv.dataset.beginning import Planned, find_own, lock, refuse_existing, replace_dataset, tidy
from omniscv.dataset.belongings import is_marker
from omniscv.dataset.manifest import Manifest
from omniscv.dataset.origin import Origin
from omniscv.dataset.writer import Writer
from omniscv.errors import (
    ArgumentError,
    DamagedFileError,
    DatasetError,
    MissingFileError,
    RecordingError,
    SourceError,
)
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.job import Job
from omniscv.make.contents import (
    Contents,
    check_dataset,
    check_faults,
    check_source,
    check_worlds,
    frame_count,
    of_world,
    split_warnings,
)
from omniscv.make.frames import Failures, FrameMaker
from omniscv.make.instants import SharedFrames, check_keys, frames_by_instant, keys_of, with_places
from omniscv.make.source import open_source, opened, origin_of
from omniscv.progress import Report
from omniscv.sources.base import Source
from omniscv.sources.recording import part_file
from omniscv.storage import Folder
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json
from omniscv.storage.local import remove_parts

_PARTS = "parts"
_FRAMES = 16
"""Frames of a part, about, unless the number of parts is given: a minute of a worker."""


@dataclass(frozen=True)
class Made:
    """Counts of frames.

    Attributes:
        written: that were made.
        kept: that existed.
        missing: of parts that are not finished; the dataset is not complete without them.
        failed: that were left out, because the job keeps going.
    """

    written: int
    kept: int
    missing: int = 0
    failed: int = 0


@dataclass(frozen=True)
class Part:
    """Part ``index`` of ``count``, from 0.

    Consecutive poses at one position are in one part if a part can hold them, as they share captures in a
    recording. All cameras of a pose are in its part.
    """

    index: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        whole_number("part.count", self.count, least=1)
        whole_number("part.index", self.index, least=0, most=self.count - 1)

    @property
    def marker(self) -> str:
        """The name of its marker in the dataset."""
        return f"{_PARTS}/{self.index:0{len(str(self.count - 1))}d}-of-{self.count}.json"

    def poses(self, poses: Sequence[Pose]) -> range:
        """Return the poses of the part, by index."""
        return range(self._first(poses, self.index), self._first(poses, self.index + 1))

    def of(self, job: Job) -> Job:
        """Return a job that records into a file of the part; ``recording merge`` joins these files."""
        if job.record is None or self.count == 1:
            return job
        return replace(job, record=part_file(job.record, self.index, self.count))

    def _first(self, poses: Sequence[Pose], index: int) -> int:
        """Return the first pose of a part: of an even division, or the start of a run of one position."""
        even, before = (len(poses) * i // self.count for i in (index, index - 1))
        first = even
        while 0 < first < len(poses) and np.array_equal(poses[first].position, poses[first - 1].position):
            first -= 1
            if first <= before:
                return even  # the run is longer than a part
        return first


def parts_of(job: Job, frames: int | None = None) -> list[Part]:
    """Return the parts of a job with about 16 frames each, the same ones every time; of several worlds, or of
    a job that is limited to so many frames, by their number."""
    if frames is None or (frames == len(job) and not job.worlds):
        poses_each = max(1, _FRAMES // max(1, len(job.cameras)))
        count = -(-len(job.poses) // poses_each)
    else:
        count = -(-frames // _FRAMES)
    count = max(1, count)
    return [Part(index, count) for index in range(count)]


def make(
    job: Job,
    *,
    existing: Literal["refuse", "resume", "replace"] = "refuse",
    shard: tuple[int, int] | None = None,
    limit: int | None = None,
    workers: int = 1,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job in its ``out``: the same bytes, however often it was interrupted.

    Args:
        job: what to make.
        existing: what happens to a dataset that is there: ``refuse``, ``resume`` it, where frames whose files
            have their checksums are kept, or ``replace`` it.
        shard: (i, n): only part i of n (:class:`Part`), into a dataset that may exist. The last
            one finishes the dataset. The folders of shards are joined by copying them into one, and are
            finished by ``resume``.
        limit: only so many frames: those whose keys have the least SHA-256, which are spread evenly.
        workers: images that are composed at a time.
        progress: called as frames progress.
        warn: called with lines about doubtful pixels and empty splits.

    Raises:
        ArgumentError: the dataset cannot be made of this job, or another one exists.
        UnmatchedNamesError: no rule of the classes matches some objects.
        OmniscvError: as :func:`omniscv.render`, a truth or a format; frames that were made stay.
    """
    whole_number("workers", workers, most=256)
    part = Part() if shard is None else Part(*shard)
    folder = storage.folder(job.out)
    if existing == "replace" and shard:
        raise ArgumentError("existing: expected refuse or resume with a shard, got replace")
    find_own(folder)  # refuses what is none, before anything is captured
    if existing == "refuse" and not shard:
        refuse_existing(folder)
    if job.worlds:  # one world is checked where it is opened, before the first capture
        job = check_worlds(job, dataset=True, opens=part.of)
    chosen = None if limit is None else chosen_keys(job, whole_number("limit", limit, least=1))
    complete = folder.exists(manifest.FRAMES) and not _markers(folder)
    how = _How(workers, progress, warn, existing == "replace", chosen)
    made, worlds, frames = _run(job, part, how)
    if shard and complete and not made.written:
        keys = {frame.key for frame in _listed(folder)}
        if all(frame.key in keys for frame in frames):
            folder.remove_files([part.marker])
            return Made(0, made.kept)
    unfinished = _unfinished(folder, part.count)
    if part in unfinished:  # another process has finished the dataset, and removed the markers
        return made
    missing = sum(len(_keys(world, other, chosen)) for other in unfinished for world in worlds)
    if chosen is not None and unfinished:
        missing = max(1, missing)  # a part without chosen frames has a marker, too
    if not missing:
        finish(job, part.count, warn)
    return replace(made, missing=missing)


def chosen_keys(job: Job, count: int) -> frozenset[str]:
    """Return so many keys of a job's frames: those whose SHA-256 is least."""
    keys: list[str] = []
    for world in job.each:
        with nullcontext((world, None)) if world.sampling is None else opened(world) as (known, _):
            keys += keys_of(known)
    return frozenset(sorted(keys, key=lambda key: hashlib.sha256(key.encode()).digest())[:count])


def _keys(job: Job, part: Part, chosen: Collection[str] | None) -> list[str]:
    """Return the keys of a part's frames, of those that are chosen."""
    return [key for key in keys_of(job, part.poses(job.poses)) if chosen is None or key in chosen]


def run_part(
    job: Job,
    part: Part,
    *,
    source: Source | None = None,
    warn: Callable[[str], None] | None = None,
    progress: Report | None = None,
    chosen: Collection[str] | None = None,
    begins: Callable[[str], None] | None = None,
    lost: Mapping[str, str] | None = None,
    carefully: bool = False,
) -> Made:
    """Make the frames of a part of a job in its ``out``, and then the part's marker.

    The same job and part give the same bytes in every process. A part that has its marker is not made again;
    of one that was interrupted, whole frames are kept.

    Args:
        job, part: what to make.
        source: the job's, without its recording; it stays open. One is opened for this part if not given.
        warn, progress: as of :func:`make`.
        chosen: the keys of the frames that are made; of all if not given.
        begins: called with a frame's key before it is captured.
        lost: frames that are left out, as if they had failed, by key with their errors.
        carefully: whether a frame is written before the next one is begun.

    Raises:
        OmniscvError: as :func:`make`.
    """
    return _run(job, part, _How(1, progress, warn, False, chosen, begins, lost or {}, carefully), source)[0]


class _How(NamedTuple):
    """How a part is made: the arguments of :func:`make` and :func:`run_part`."""

    workers: int = 1
    progress: Report | None = None
    warn: Callable[[str], None] | None = None
    replaces: bool = False
    chosen: Collection[str] | None = None
    begins: Callable[[str], None] | None = None
    lost: Mapping[str, str] = {}
    carefully: bool = False


def _run(
    job: Job, part: Part, how: _How, source: Source | None = None
) -> tuple[Made, list[Job], list[Frame]]:
    """Make a part, world by world; return the counts, the worlds with their poses, and the frames."""
    chosen = how.chosen
    warn = how.warn or (lambda line: None)
    contents = [check_dataset(world) for world in job.each]
    check_keys(job)
    folder = storage.folder(job.out)
    settings = contents[0].settings(job)
    failures = Failures(job.failures.skip * sum(map(frame_count, job.each)), warn)
    labelled = any("labels" in modalities.get(mode).derives for mode in job.modes)
    ids = _all_names(job) if labelled and job.worlds and part.count > 1 else {}
    worlds = list(job.each)
    written = list[Frame]()
    kept = 0
    made = 0
    for at, world in enumerate(job.each):
        try:
            with ExitStack() as stack, opened(part.of(world), source) as (world, live):
                worlds[at] = world = with_places(world)
                scene = "/".join(name for name in astuple(live.scene_identity) if name)
                planned = list(frames_by_instant(world, part.poses(world.poses), scene))
                frames = [frame for shared in planned for frame in shared.frames]
                frames = [frame for frame in frames if chosen is None or frame.key in chosen]
                renderer = Renderer(live)
                cameras = job.cameras if job.worlds else world.cameras
                check_source(world, contents[at], renderer, planned)
                if not job.worlds:
                    check_faults(job, planned)
                if how.replaces and at == 0:
                    replace_dataset(folder)
                names = live.objects().names() if labelled else ()  # those that the source has now
                known = ids or manifest.with_names({}, names)
                origin = Origin({world.world: origin_of(world, live)})
                plan = _Plan(world, scene, planned if part.count == 1 else None)
                writer = Writer(
                    job.out,
                    resume=True,
                    keys=[frame.key for frame in frames],
                    planned=Planned(plan.frames, [each.world for each in job.each], part.count > 1),
                    image_format=job.image_format,
                    store=job.store,
                    depth_format=job.depth_format,
                    begun=Manifest(cameras, known, contents[0].classes, settings, origin=origin),
                    closed=part.count > 1,
                    media=job.recipe.media,
                )
                stack.callback(writer.close)
                writer.keep_marked((_read_marker(folder, writer.manifest, part) or ((), ()))[0])
                writer.refuse(frame.key for frame in written)  # of the worlds before
                missing = writer.missing(frames)
                for frame in frames:
                    if frame.key in missing and frame.key in how.lost:
                        cause = SourceError(how.lost[frame.key])
                        failures.add({frame.key: frame.varied}, world.world, cause)
                maker = FrameMaker(
                    world,
                    contents[at],
                    renderer,
                    writer,
                    how.workers,
                    warn,
                    failures,
                    begins=how.begins,
                    carefully=how.carefully,
                )
                maker.run(planned, missing - how.lost.keys(), how.progress)
                written += writer.frames(frame.key for frame in frames if frame.key not in failures.lines)
                kept += len(frames) - len(missing)
                made += len(missing - failures.lines.keys())
        except (SourceError, RecordingError) as cause:
            if not job.worlds:
                raise
            there = {frame.key for frame in written}
            lost = [key for key in _keys(world, part, chosen) if key not in there] or [world.world]
            with of_world(world):
                failures.add({key: {} for key in lost}, world.world, cause)
    lines = [frame.to_dict() for frame in written]
    content = {"sha256": _checksum(lines), "frames": lines, "versions": versions()}
    whole = manifest.read(folder)
    made_worlds = () if whole.origin is None else tuple(whole.origin.worlds)
    content["made_of"] = {world: whole.made_of(world) for world in made_worlds}
    if failures.lines:
        content["failed"] = list(failures.lines.values())
    folder.put(part.marker, json.dumps(content, allow_nan=False).encode())
    return Made(made, kept, failed=len(failures.lines)), worlds, written


class _Plan(NamedTuple):
    """The frames of a world: those of a part may be known, and all are found when they are asked for."""

    world: Job
    scene: str
    known: Sequence[SharedFrames] | None

    def frames(self) -> list[Frame]:
        """Return all frames of the world, without files."""
        planned = self.known
        if planned is None:
            planned = list(frames_by_instant(self.world, scene=self.scene))
        return [frame for shared in planned for frame in shared.frames]


def _all_names(job: Job) -> dict[str, int]:
    """Return the ids of the objects of all worlds, as making one world after the other gives them."""
    ids: dict[str, int] = {}
    for world in job.worlds:
        with suppress(SourceError, RecordingError), open_source(world) as source:
            ids = manifest.with_names(ids, set(source.objects().names()) - ids.keys())
    return ids


def finish(job: Job, count: int, warn: Callable[[str], None] | None = None) -> None:
    """Join the markers of all parts, of so many, into ``frames.jsonl``; export; remove the markers, and what
    killed processes have left. If another process has just finished the dataset, nothing is left to do.

    DatasetError: the marker of a part is missing or damaged. OmniscvError: as an export.
    """
    folder = storage.folder(job.out)
    with lock(folder):
        if folder.exists(manifest.FRAMES) and len(_unfinished(folder, count)) == count:
            return
        whole = manifest.read(folder)
        parts = [Part(index, count) for index in range(count)]
        marked = folder.each(lambda part: _read_marker(folder, whole, part), parts)
        _refuse_mixed(folder, whole)
        if None in marked:
            index = marked.index(None)
            wanted = f"expected markers of {count} finished parts, part {index} has none"
            raise DatasetError(f"{folder}: {wanted}; make it again with --shard {index}/{count}")
        listed = {frame.key: frame for frame in _listed(folder)}  # also of worlds that were not opened now
        of_parts = [of_part for of_part in marked if of_part]
        made = {frame.key: frame for frames, _ in of_parts for frame in frames}
        lines = (line for _, failed in of_parts for line in failed)
        failed = {line["key"]: line for line in lines if line["key"] not in made}
        frames = {**{key: frame for key, frame in listed.items() if key not in failed}, **made}
        manifest.write_failed(folder, failed.values())
        if len(failed) > job.failures.skip * (whole_count := len(frames) + len(failed)):
            wanted = f"expected at most {job.failures.skip:.3g} of {whole_count} frames to fail"
            advice = f"see {manifest.FAILED}; --resume tries them again"
            raise DatasetError(f"failures: {wanted}, got {len(failed)}; {advice}")
        manifest.write_frames(folder, frames.values())
        folder.remove(manifest.PLANNED)
        gone = [entry.path for key in failed.keys() & listed for entry in listed[key].entries.values()]
        folder.remove_files(gone)  # images of frames that were made before, and cannot be made again
        if warn and (lacking := sum(bool(frame.watch) for frame in frames.values())):
            warn(f"watch: the world has left objects out of {lacking} frames; see {manifest.FRAMES}")
        if warn and job.recipe.split:
            fixed = {world.world for world in job.worlds if world.world_split}
            free = [frame for frame in frames.values() if frame.world not in fixed]
            for line in split_warnings(job.recipe.split, free):
                warn(line)
        written = manifest.open(job.out)
        exports = Contents.of(job).exports
        for export in exports:
            shown = [frame.kinds for frame in written if export.shows(frame.camera_name)]
            if shown:  # truths may have been left out
                export.check(job.cameras, set.intersection(*shown))
        for line in exported.renew_exports(folder, exports, written):
            if warn:
                warn(line)
        markers = _markers(folder)
        if folder.local is not None:
            for name in markers:
                remove_parts(folder.local / name)
        folder.remove_files(markers)
        tidy(folder)


def _listed(folder: Folder) -> list[Frame]:
    """Return the frames of ``frames.jsonl``; none without the file."""
    return manifest.read_frames(folder) if folder.exists(manifest.FRAMES) else []


# -- markers ---------------------------------------------------------------------------------------------


Marked = tuple[list[Frame], list[dict[str, Any]]]
"""The frames of a finished part, and the lines of those that failed."""


def _read_marker(folder: Folder, manifest: Manifest, part: Part) -> Marked | None:
    """Return what a part's marker holds; None if it is missing or damaged."""
    try:
        content = parse_json(folder.read(part.marker, MOST_JSON_BYTES))
        if content["sha256"] != _checksum(content["frames"]):
            return None
        return [manifest.frame(line, folder) for line in content["frames"]], content.get("failed", [])
    except (MissingFileError, DamagedFileError, ValueError, TypeError, KeyError):
        return None


def _refuse_mixed(folder: Folder, whole: Manifest) -> None:
    """Raise DatasetError if a part was made of something else than the dataset, or with other versions, as
    where folders of several jobs were copied into one."""
    runs = (whole.versions,) if whole.origin is None else whole.origin.runs
    for name in _markers(folder):
        try:
            content = parse_json(folder.read(name, MOST_JSON_BYTES))
            made_with = content.get("versions")
            made_of = dict(content.get("made_of", {}))
        except (MissingFileError, DamagedFileError, ArgumentError, AttributeError, TypeError, ValueError):
            continue  # a damaged marker counts for nothing
        wanted = f"{folder}/{name}: expected a part of this dataset"
        advice = "remove its files, and make it again"
        if made_with is not None and made_with not in runs:
            known = " or ".join(_in_words(run) for run in runs)
            raise DatasetError(f"{wanted}, made with {known}; got {_in_words(made_with)}; {advice}")
        for world, digest in made_of.items():
            if digest != whole.made_of(world):
                raise DatasetError(f"{wanted}, got one of another job or source; {advice}")


def _in_words(run: Mapping[str, str]) -> str:
    return ", ".join(f"{package} {version}" for package, version in run.items())


def _markers(folder: Folder) -> list[str]:
    """Return the names of all markers, of any number of parts."""
    return [name for name in folder.names(f"{_PARTS}/") if is_marker(name)]


def _unfinished(folder: Folder, count: int) -> list[Part]:
    """Return the parts, of so many, that have no marker."""
    names = set(_markers(folder))
    return [part for index in range(count) if (part := Part(index, count)).marker not in names]


def _checksum(lines: list[Any]) -> str:
    return hashlib.sha256(json.dumps(lines, sort_keys=True).encode()).hexdigest()
