"""Make the dataset that a job describes, at once or part by part.

A part is a run of consecutive poses, which any process makes into the same bytes. Its last file is its
marker, ``parts/INDEX-of-COUNT.json``: its frames with their checksums. A dataset is finished by joining the
markers of all its parts into ``frames.jsonl``. Then they are removed, so that a dataset has the same files
however it was made.
"""

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
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
    ExistingDatasetError,
    FailedFramesError,
    MissingFileError,
    OtherDatasetError,
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
from omniscv.progress import Report, in_phase, phase
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
        even = len(poses) * index // self.count
        before = len(poses) * (index - 1) // self.count
        first = even
        while 0 < first < len(poses) and np.array_equal(poses[first].position, poses[first - 1].position):
            first -= 1
            if first <= before:
                return even  # the run is longer than a part
        return first


def parts_of(job: Job, frames: int | None = None) -> list[Part]:
    """Return the parts of a ``job`` with about 16 frames each, the same ones every time.

    ``frames`` is their number, if the job is limited to so many, or has several worlds; None: all frames of
    one world.
    """
    if frames is None or (frames == len(job) and not job.worlds):
        poses_each = max(1, _FRAMES // max(1, len(job.cameras)))
        count = -(-len(job.poses) // poses_each)
    else:
        count = -(-frames // _FRAMES)
    return _all_parts(max(1, count))


def _all_parts(count: int) -> list[Part]:
    return [Part(index, count) for index in range(count)]


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


def make(
    job: Job,
    *,
    existing: Literal["refuse", "resume", "replace"] = "resume",
    shard: tuple[int, int] | None = None,
    limit: int | None = None,
    workers: int = 1,
    progress: Report | None = None,
    warn: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job in its ``out``: the same bytes, however often it was interrupted.

    Args:
        job: what to make.
        existing: what happens to an existing dataset: ``resume`` that of the same job, which keeps frames
            whose files have their checksums, ``refuse`` any, or ``replace`` it.
        shard: (i, n): only part i of n (:class:`Part`), into a dataset that may exist. The last
            one finishes the dataset. The folders of shards are joined by copying them into one, and are
            finished by making the job there without ``shard``.
        limit: only so many frames: those whose keys have the least SHA-256, which are spread evenly.
        workers: images that are composed at a time.
        progress: called as frames progress.
        warn: called with lines about doubtful pixels and empty splits.

    Raises:
        ArgumentError: the dataset cannot be made of this job.
        ExistingDatasetError: one exists, and is refused.
        OtherDatasetError: one of another job exists.
        UnmatchedNamesError: no rule of the classes matches some objects.
        OmniscvError: as :func:`omniscv.render`, a truth or a format; frames that were made stay.
    """
    whole_number("workers", workers, most=256)
    part = Part() if shard is None else Part(*shard)
    how = _How(workers, progress, warn, existing == "replace")
    try:
        return _make(job, part, how, existing, limit, is_shard=shard is not None)
    except ExistingDatasetError as error:
        advice = "existing='resume' completes it, existing='replace' replaces it, or write elsewhere"
        raise error.advised(advice) from None
    except OtherDatasetError as error:
        raise error.advised("existing='replace' replaces the dataset, or write elsewhere") from None


def _make(job: Job, part: Part, how: _How, existing: str, limit: int | None, *, is_shard: bool) -> Made:
    """Make a part of the dataset of a job, and finish the dataset if it is the last one.

    Args:
        job: what to make.
        part: of its frames; all if it is no shard.
        how: it is made.
        existing: as of :func:`make`.
        limit: as of :func:`make`.
        is_shard: whether other processes make other parts.

    Raises:
        OmniscvError: as :func:`make`.
    """
    folder = storage.folder(job.out)
    _check_existing(folder, existing, is_shard)
    if job.worlds:  # one world is checked where it is opened, before the first capture
        job = check_worlds(job, dataset=True, opens=part.of)
    chosen = None if limit is None else chosen_keys(job, whole_number("limit", limit, least=1))
    complete = folder.exists(manifest.FRAMES) and not _markers(folder)
    made, worlds, frames = _run(job, part, how._replace(chosen=chosen))
    if is_shard and complete and not made.written and _are_listed(folder, frames):
        folder.remove_files([part.marker])
        return Made(0, made.kept)
    unfinished = _unfinished(folder, part.count)
    if part in unfinished:  # another process has finished the dataset, and removed the markers
        return made
    missing = _count_missing(worlds, unfinished, chosen)
    if not missing:
        finish(job, part.count, how.warn, limited=chosen is not None)
    return replace(made, missing=missing)


def _check_existing(folder: Folder, existing: str, is_shard: bool) -> None:
    """Raise ArgumentError for a dataset in a folder that a job may not go on with, before any capture."""
    if existing == "replace" and is_shard:
        raise ArgumentError("existing: expected refuse or resume with a shard, got replace")
    find_own(folder)  # refuses a file of another program
    if existing == "refuse" and not is_shard:
        refuse_existing(folder)


def _are_listed(folder: Folder, frames: Iterable[Frame]) -> bool:
    """Return whether ``frames.jsonl`` lists all of some frames."""
    listed = {frame.key for frame in _listed(folder)}
    return listed.issuperset(frame.key for frame in frames)


def _count_missing(worlds: Sequence[Job], unfinished: Sequence[Part], chosen: Collection[str] | None) -> int:
    """Return the number of frames of unfinished parts; with chosen frames, at least 1 if there is one.

    A part of which no frame is chosen has a marker, too.
    """
    missing = 0
    for part in unfinished:
        for world in worlds:
            missing += len(_keys(world, part, chosen))
    if chosen is not None and unfinished:
        return max(1, missing)
    return missing


def chosen_keys(job: Job, count: int) -> frozenset[str]:
    """Return ``count`` keys of a job's frames: those whose SHA-256 is least."""
    keys: list[str] = []
    for world in job.each:
        poses = getattr(world.sampling, "count", 0)
        if world.sampling is None or poses:  # their number is known without a search of places
            keys += keys_of(world, count=poses or len(world.poses))
            continue
        with opened(world) as (known, _):
            keys += keys_of(known)
    keys.sort(key=lambda key: hashlib.sha256(key.encode()).digest())
    return frozenset(keys[:count])


def _keys(job: Job, part: Part, chosen: Collection[str] | None) -> list[str]:
    """Return the keys of a part's frames, of those that are chosen."""
    keys = keys_of(job, part.poses(job.poses))
    return list(keys if chosen is None else filter(chosen.__contains__, keys))


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
        job: what to make.
        part: of its frames.
        source: the job's, without its recording; it stays open. One is opened for this part if not given.
        warn: as of :func:`make`.
        progress: as of :func:`make`.
        chosen: the keys of the frames that are made; of all if not given.
        begins: called with a frame's key before it is captured.
        lost: frames that are left out, as if they had failed, by key with their errors.
        carefully: whether a frame is written before the next one is begun.

    Raises:
        OmniscvError: as :func:`make`.
    """
    return _run(job, part, _How(1, progress, warn, False, chosen, begins, lost or {}, carefully), source)[0]


def _run(
    job: Job, part: Part, how: _How, source: Source | None = None
) -> tuple[Made, list[Job], list[Frame]]:
    """Make a part, world by world; return the counts, the worlds with their poses, and the frames."""
    run = _PartRun(job, part, how)
    for number in range(len(job.each)):
        try:
            run.make_world(number, source)
        except (SourceError, RecordingError) as cause:
            if not job.worlds:
                raise
            run.lose_world(number, cause)
    run.write_marker()
    made = Made(run.made, run.kept, failed=len(run.failures.lines))
    return made, run.worlds, run.written


class _Plan(NamedTuple):
    """The frames of a world; None are known if only a part is planned, and all are planned when needed."""

    world: Job
    scene: str
    known: Sequence[SharedFrames] | None

    def frames(self) -> list[Frame]:
        """Return all frames of the world, without files."""
        planned = self.known
        if planned is None:
            planned = list(frames_by_instant(self.world, scene=self.scene))
        return _frames_of(planned)


def _frames_of(planned: Iterable[SharedFrames]) -> list[Frame]:
    frames: list[Frame] = []
    for shared in planned:
        frames += shared.frames
    return frames


def _ignore(line: str) -> None:
    """Take a warning of a caller that wants none."""


class _PartRun:
    """Makes a part of a job, one world after the other.

    Args:
        job: what to make.
        part: of its frames.
        how: it is made.

    Attributes:
        worlds: of the job; those that were opened have their poses.
        written: the frames of the part that are in the dataset.
        kept: how many of them existed.
        made: how many of them are new.
        failures: the frames that were left out.

    Raises:
        ArgumentError: no dataset can be made of the job.
    """

    def __init__(self, job: Job, part: Part, how: _How) -> None:
        if not how.replaces:
            job = _with_rule_of(storage.folder(job.out), job)
        self._job = job
        self._part = part
        self._how = how
        self._warn = _ignore if how.warn is None else how.warn
        self._contents = list(map(check_dataset, job.each))
        check_keys(job)
        self._folder = storage.folder(job.out)
        self._settings = self._contents[0].settings(job)

        self.worlds = list(job.each)
        self.written: list[Frame] = []
        self.kept = 0
        self.made = 0
        self.failures = Failures(job.failures.skip * sum(map(frame_count, job.each)), self._warn)

        self._has_labels = any("labels" in modalities.get(mode).derives for mode in job.modes)
        self._ids: dict[str, int] = {}  # of the objects of all worlds, where parts must give the same
        if self._has_labels and job.worlds and part.count > 1:
            self._ids = _all_names(job)

    def make_world(self, number: int, source: Source | None) -> None:
        """Make the frames of the world ``number``, in its ``source``; None: the source is opened for it."""
        how = self._how
        contents = self._contents[number]
        with ExitStack() as stack, opened(self._part.of(self.worlds[number]), source) as (world, live):
            world = with_places(world)
            self.worlds[number] = world
            scene = "/".join(name for name in astuple(live.scene_identity) if name)
            renderer = Renderer(live)
            planned = self._listed_frames(world, scene, contents, renderer)
            if how.replaces and number == 0:
                replace_dataset(self._folder)
            frames = self._chosen_frames(planned)
            writer = self._begin(world, live, frames, _Plan(world, scene, planned))
            stack.callback(writer.close)
            marked = _read_marker(self._folder, writer.manifest, self._part)
            if marked is not None:
                writer.keep_marked(marked[0])
            writer.refuse(frame.key for frame in self.written)  # of the worlds before
            with phase("comparing files"):
                missing = writer.missing(frames)
            self._leave_out_lost(world, frames, missing)
            maker = FrameMaker(
                world,
                contents,
                renderer,
                writer,
                how.workers,
                self._warn,
                self.failures,
                begins=how.begins,
                carefully=how.carefully,
            )
            maker.run(planned, missing - how.lost.keys(), how.progress)
            failed = self.failures.lines.keys()
            self.written += writer.frames(frame.key for frame in frames if frame.key not in failed)
            self.kept += len(frames) - len(missing)
            self.made += len(missing - failed)

    def _listed_frames(
        self, world: Job, scene: str, contents: Contents, renderer: Renderer
    ) -> list[SharedFrames]:
        """Return the frames of the part in a world, after checks of them and of the source.

        Args:
            world: with its poses.
            scene: identity of the source's scene.
            contents: of the dataset.
            renderer: of the open source.
        """
        with phase("listing frames"):
            planned = list(frames_by_instant(world, self._part.poses(world.poses), scene))
        with phase("checking the source"):
            check_source(world, contents, renderer, planned)
        if not self._job.worlds:
            check_faults(self._job, planned)
        return planned

    def _chosen_frames(self, planned: Sequence[SharedFrames]) -> list[Frame]:
        """Return those of planned frames whose keys are chosen, if some are."""
        chosen = self._how.chosen
        frames = []
        for frame in _frames_of(planned):
            if chosen is None or frame.key in chosen:
                frames.append(frame)
        return frames

    def _begin(self, world: Job, live: Source, frames: Sequence[Frame], plan: _Plan) -> Writer:
        """Begin the dataset with a world, or extend it, and return a writer of its frames.

        Args:
            world: with its poses.
            live: its open source.
            frames: that are to be made.
            plan: of the part; of the whole world if there is one part only.
        """
        job = self._job
        names = self._ids
        if self._has_labels:
            present = live.objects().names()  # those that the source has now
            names = names or manifest.with_names({}, present)
        begun = Manifest(
            cameras=job.cameras if job.worlds else world.cameras,
            names=names,
            rules=self._contents[0].classes,
            settings=self._settings,
            origin=Origin({world.world: origin_of(world, live)}),
        )
        is_part = self._part.count > 1
        if is_part:
            plan = plan._replace(known=None)
        return Writer(
            job.out,
            resume=True,
            keys=[frame.key for frame in frames],
            planned=Planned(plan.frames, [other.world for other in job.each], is_part),
            image_format=job.image_format,
            store=job.store,
            depth_format=job.depth_format,
            begun=begun,
            closed=is_part,
            media=job.recipe.media,
        )

    def _leave_out_lost(self, world: Job, frames: Sequence[Frame], missing: Collection[str]) -> None:
        """Leave out those missing frames of a world that are known to be lost, with their errors."""
        lost = self._how.lost
        for frame in frames:
            if frame.key in missing and frame.key in lost:
                self.failures.add({frame.key: frame.varied}, world.world, SourceError(lost[frame.key]))

    def lose_world(self, number: int, cause: SourceError | RecordingError) -> None:
        """Leave out the frames of the world ``number`` that are not written, since its source has failed.

        The ``cause`` is raised if they are more than may fail.
        """
        world = self.worlds[number]
        lost: dict[str, dict[str, Any]] = {key: {} for key in _keys(world, self._part, self._how.chosen)}
        for frame in self.written:
            lost.pop(frame.key, None)
        if not lost:
            lost[world.world] = {}
        with of_world(world):
            self.failures.add(lost, world.world, cause)

    def write_marker(self) -> None:
        """Write the marker of the part, its last file."""
        lines = list(map(Frame.to_dict, self.written))
        content = {"sha256": _checksum(lines), "frames": lines, "versions": versions()}
        whole = manifest.read(self._folder)
        worlds = () if whole.origin is None else whole.origin.worlds
        content["made_of"] = {world: whole.made_of(world) for world in worlds}
        if self.failures.lines:
            content["failed"] = list(self.failures.lines.values())
        self._folder.put(self._part.marker, json.dumps(content, allow_nan=False).encode())


def _with_rule_of(folder: Folder, job: Job) -> Job:
    """Return a job that divides places by the rule of the dataset in its folder, unless it says another."""
    split = job.recipe.split
    whole = find_own(folder)
    settings = None if whole is None else whole.settings.get("splits")
    if split is None or split.rule is not None or not settings:
        return job
    recipe = replace(job.recipe, split=replace(split, rule=settings.get("rule", "hash")))
    worlds = tuple(replace(world, recipe=recipe) for world in job.worlds)
    return replace(job, recipe=recipe, worlds=worlds)


def _all_names(job: Job) -> dict[str, int]:
    """Return the ids of the objects of all worlds, as making one world after the other gives them."""
    ids: dict[str, int] = {}
    for world in job.worlds:
        with suppress(SourceError, RecordingError), open_source(world) as source:
            ids = manifest.with_names(ids, set(source.objects().names()) - ids.keys())
    return ids


def finish(job: Job, count: int, warn: Callable[[str], None] | None = None, *, limited: bool = False) -> None:
    """Finish the dataset of a ``job`` whose ``count`` parts are made.

    Their markers are joined into ``frames.jsonl``, exports are written, and the markers are removed, with
    what killed processes have left. If another process has just finished the dataset, nothing is left to do.

    Args:
        job: whose dataset is finished.
        count: of its parts.
        warn: called with lines about objects that are missing, splits and exports.
        limited: whether only some frames were made, of which splits have no shares yet.

    Raises:
        DatasetError: the marker of a part is missing or damaged, or more frames failed than may.
        OmniscvError: as an export.
    """
    folder = storage.folder(job.out)
    with lock(folder):
        if folder.exists(manifest.FRAMES) and len(_unfinished(folder, count)) == count:
            return
        made, failed = _join_markers(folder, count)
        frames = _write_lists(job, folder, made, failed)
        if warn is None:
            warn = _ignore
        for line in _frame_warnings(job, frames, limited):
            warn(line)
        for line in _export_all(job, folder):
            warn(line)
        markers = _markers(folder)
        if folder.local is not None:
            for name in markers:
                remove_parts(folder.local / name)
        folder.remove_files(markers)
        tidy(folder)


def _join_markers(folder: Folder, count: int) -> tuple[dict[str, Frame], dict[str, dict[str, Any]]]:
    """Return the frames of all parts, of so many, by key, and the lines of frames that failed in all of them.

    DatasetError: a part has no marker, or is one of something else than the dataset.
    """
    whole = manifest.read(folder)
    marked = folder.each(lambda part: _read_marker(folder, whole, part), _all_parts(count))
    _refuse_mixed(folder, whole)
    made = {}
    lines = []
    for index, content in enumerate(marked):
        if content is None:
            wanted = f"expected markers of {count} finished parts, part {index} has none"
            raise DatasetError(f"{folder}: {wanted}; make it again with --shard {index}/{count}")
        frames, failed_lines = content
        lines += failed_lines
        for frame in frames:
            made[frame.key] = frame
    failed = {}
    for line in lines:
        if line["key"] not in made:
            failed[line["key"]] = line
    return made, failed


def _write_lists(
    job: Job, folder: Folder, made: Mapping[str, Frame], failed: Mapping[str, Mapping[str, Any]]
) -> list[Frame]:
    """Write ``frames.jsonl`` and ``failed.jsonl``, and return the frames.

    Frames that are listed, and are of worlds that were not opened now, stay. Images of frames that were made
    before, and cannot be made again, are removed.

    Args:
        job: of the dataset.
        folder: of the dataset.
        made: frames by key.
        failed: by key, lines of the frames that failed.

    Raises:
        FailedFramesError: more frames failed than the job allows.
    """
    frames = {}
    gone = []
    for frame in _listed(folder):
        if frame.key in failed:
            for entry in frame.entries.values():
                gone.append(entry.path)
        else:
            frames[frame.key] = frame
    frames.update(made)
    manifest.write_failed(folder, failed.values())
    count = len(frames) + len(failed)
    if len(failed) > job.failures.skip * count:
        wanted = f"expected at most {job.failures.skip:.3g} of {count} frames to fail"
        advice = "making it again tries them again"
        raise FailedFramesError(f"failures: {wanted}, got {len(failed)}; see {manifest.FAILED}", advice)
    manifest.write_frames(folder, frames.values())
    folder.remove(manifest.PLANNED)
    folder.remove_files(gone)
    return list(frames.values())


def _frame_warnings(job: Job, frames: Sequence[Frame], limited: bool) -> Iterator[str]:
    """Yield a line if a world has left objects out of frames, and lines about splits."""
    lacking = sum(bool(frame.watch) for frame in frames)
    if lacking:
        yield f"watch: the world has left objects out of {lacking} frames; see {manifest.FRAMES}"
    if job.recipe.split and not limited:
        fixed = {world.world for world in job.worlds if world.world_split}
        free = [frame for frame in frames if frame.world not in fixed]
        yield from split_warnings(job.recipe.split, free)


def _export_all(job: Job, folder: Folder) -> list[str]:
    """Write the exports of a job's dataset; return a line for each of others that could not be renewed."""
    frames = manifest.open(job.out)
    exports = Contents.of(job).exports
    for export in in_phase("checking exports", exports):
        kinds = [frame.kinds for frame in frames if export.shows(frame.camera_name)]
        if kinds:  # truths may have been left out
            export.check(job.cameras, set.intersection(*kinds))
    with phase("writing exports"):
        return exported.renew_exports(folder, exports, frames)


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
            known = " or ".join(map(_in_words, runs))
            raise DatasetError(f"{wanted}, made with {known}; got {_in_words(made_with)}; {advice}")
        for world, digest in made_of.items():
            if digest != whole.made_of(world):
                raise DatasetError(f"{wanted}, got one of another job or source; {advice}")


def _in_words(run: Mapping[str, str]) -> str:
    return ", ".join(f"{package} {version}" for package, version in run.items())


def _markers(folder: Folder) -> list[str]:
    """Return the names of all markers, of any number of parts."""
    return list(filter(is_marker, folder.names(f"{_PARTS}/")))


def _unfinished(folder: Folder, count: int) -> list[Part]:
    """Return the parts, of so many, that have no marker."""
    names = set(_markers(folder))
    return [part for part in _all_parts(count) if part.marker not in names]


def _checksum(lines: list[Any]) -> str:
    return hashlib.sha256(json.dumps(lines, sort_keys=True).encode()).hexdigest()
