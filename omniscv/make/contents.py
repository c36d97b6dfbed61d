"""Check a job before anything is captured, and look up what its dataset holds."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from typing import Any

from omniscv import modalities, planning
from omniscv.arguments import one_of, stem, texts, within
from omniscv.compose.files import check_format
from omniscv.compose.renderer import Renderer
from omniscv.dataset import exporting
from omniscv.dataset.exporting import Export
from omniscv.errors import ArgumentError, OmniscvError, RecordingError, SourceError
from omniscv.frame import IMAGE, Frame
from omniscv.frame.classes import ClassRules, class_rules
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.job import Exposure, Job, Split
from omniscv.make.instants import SharedFrames, check_keys, frames_by_instant, renderer_at
from omniscv.make.source import opened
from omniscv.planning.strategies import MEAN_OF_A_FACE
from omniscv.records import mapping
from omniscv.sources.base import Source, check_modes, known_objects
from omniscv.sources.recording.files import target_of
from omniscv.sources.recording.store import Store
from omniscv.sources.registry import scheme_of
from omniscv.storage import is_url
from omniscv.truth import registry as truths

_SPLIT_OFF = 0.02  # of all frames: how far shares of splits may be off without a line


def check(job: Job) -> Contents:
    """Refuse a job that cannot be rendered, as far as that is known without its source; return its
    contents."""
    planning.get(job.options.strategy)
    check_format(job.image_format, job.store, job.depth_format)
    return Contents.of(job)


def check_dataset(job: Job) -> Contents:
    """Refuse a job whose dataset cannot be made, as far as that is known without its source; return its
    contents."""
    contents = check(job)
    for name in job.cameras:
        stem("camera", name)
    kinds = contents.kinds(job)
    if contents.classes is not None and "labels" not in kinds:
        raise _missing_modes("classes", ["object_mask"], job)
    if job.recipe.watch and (missing := [mode for mode in ("object_mask", "depth") if mode not in kinds]):
        raise _missing_modes("watch", missing, job)
    for name, cameras in contents.truth_cameras.items():
        for camera in cameras:
            one_of(f"truth.{name}.cameras", camera, job.cameras)
    for name, options in contents.truth.items():
        truth = truths.get(name)
        if missing := [mode for mode in truth.needs if mode not in kinds]:
            raise _missing_modes(f"truth.{name}", missing, job)
        with within(f"truth.{name}"):
            truth.read_options(options)
    folders: set[str] = set()
    for export in contents.exports:
        if export.out in folders:
            raise ArgumentError(f"export: expected different folders, got {export.out!r} twice; set 'out'")
        folders.add(export.out)
        export.check(job.cameras, kinds)
    return contents


@contextmanager
def of_world(world: Job) -> Iterator[None]:
    """Name a world, of several, in the messages of errors."""
    try:
        yield
    except OmniscvError as cause:
        if world.world:
            cause.args = (f"worlds.{world.world}: {cause.message}",)
        raise


def check_worlds(job: Job, *, dataset: bool, opens: Callable[[Job], Job] | None = None) -> Job:
    """Refuse a job that cannot be run, world by world, before anything but free space is captured.

    Each source is opened and closed. A packaged game is not launched: its file must be there. A world that
    cannot be opened is accepted if some frames may fail.

    Args:
        job: whose worlds are checked.
        dataset: whether it makes a dataset, not images alone.
        opens: returns the job of a world with the recording that it is opened with; none if not given.

    Returns:
        The job with the poses that were sampled.
    """
    contents = []
    for world in job.each:
        with of_world(world):
            contents.append((check_dataset if dataset else check)(world))
            record = None if world.record is None else target_of(world.record)
            if record is not None and os.path.isfile(record) and os.path.getsize(record):
                Store(record).close()  # refuses what is no recording
            if record is not None and (os.path.isdir(record) or str(record) == os.path.abspath(job.out)):
                raise ArgumentError(f"record: expected a file such as room.sqlite, got a folder: {record}")
            for game in (address for address in world.sources if scheme_of(address) == "launch"):
                if not os.path.isfile(path := game.partition(":")[2].removeprefix("//").partition("?")[0]):
                    raise ArgumentError(f"source: expected the file of a game, got none at {path}")
    check_keys(job)
    if not is_url(job.out) and os.path.exists(job.out) and not os.path.isdir(job.out):
        raise ArgumentError(f"out: expected a folder or a free name, got a file: {job.out}")
    worlds = list(job.each)
    planned = list[SharedFrames]()
    for at, world in enumerate(job.each):
        if any(scheme_of(address) == "launch" for address in world.sources):
            continue
        with of_world(world):
            try:
                with opened(opens(world) if opens else replace(world, record=None)) as (known, source):
                    frames = list(frames_by_instant(known))
                    check_source(known, contents[at] if dataset else Contents(), Renderer(source), frames)
                    worlds[at] = replace(known, draws=None, record=world.record)
                    planned += frames
            except (SourceError, RecordingError):
                if not job.failures.skip:
                    raise
    check_faults(job, planned)
    return replace(job, worlds=tuple(worlds)) if job.worlds else worlds[0]


def check_faults(job: Job, planned: Iterable[SharedFrames]) -> None:
    """Refuse a job of which more frames than may fail are known to: no pose or no draw was found for them."""
    faults = [shared for shared in planned if shared.fault]
    if sum(len(shared.frames) for shared in faults) > job.failures.skip * sum(map(frame_count, job.each)):
        key = faults[0].frames[0].key
        raise ArgumentError(f"{key}, at {faults[0].frames[0].place}: {faults[0].fault}")


def frame_count(world: Job) -> int:
    """Return the number of a world's frames; of sampled poses, as far as it is known before."""
    return len(world) or len(world.cameras) * getattr(world.sampling, "count", 0)


def check_source(job: Job, contents: Contents, renderer: Renderer, planned: Sequence[SharedFrames]) -> None:
    """Refuse a job that a renderer's open source cannot give, before anything is captured or written."""
    modes = job.options.sampled(job.modes)
    source = renderer.source
    check_modes(source, modes)
    if job.motions:
        known_objects(job.motions, source.objects().names(), "motions")
    if job.options.sky:
        known_objects(job.options.sky, source.objects().names(), "sky")
    if contents.classes is not None:
        contents.classes.table(source.objects().names())
    asks = any(truths.get(name).check for name in contents.truth)
    geometry = source.geometry() if asks else SceneGeometry()
    for name, options in contents.truth.items():
        truth = truths.get(name)
        if truth.check is not None:
            with within(f"truth.{name}"):
                truth.check(source, geometry, modes, truth.read_options(options))
    check_face_size(job, source)
    if job.poses:
        _check_accuracy(job, renderer, modes)
    if source.recorded_views() is not None:
        _check_recorded(job, renderer, planned)


def _check_accuracy(job: Job, renderer: Renderer, modes: tuple[str, ...]) -> None:
    """Refuse an accuracy of no use, and budgets below what the first captures of an image take."""
    options = job.options
    has_budget = options.most_captures is not None or options.most_megapixels is not None
    for name, camera in job.cameras.items() if has_budget or options.accuracy is not None else ():
        pose = job.own_poses.get(name, job.poses)[0]
        plan = replace(renderer.plan(camera, pose, options), modes=modes).by_rays()
        if plan.doubt_share is not None and has_budget:
            plan.make(plan.modes)


def check_face_size(job: Job, source: Source) -> None:
    """Refuse a size of faces that a recording, the job's source, does not have, nor strips of it."""
    wanted = job.options.face_size
    scale = job.options.truth_scale
    views = source.recorded_views() or ()
    if wanted == "auto" or not views:
        return
    sizes = {round(2 * view.focal_px) for view in views}
    squares = {round(2 * view.focal_px) for view in views if view.width == view.height}
    if sizes.isdisjoint(round(n * wanted * share) for n in (1, scale) for share in (1, MEAN_OF_A_FACE)):
        has = " or ".join(map(str, sorted(squares or sizes)))
        raise ArgumentError(f"face_size: expected {has} px, as the recording has, or auto; got {wanted}")


def _check_recorded(job: Job, renderer: Renderer, planned: Sequence[SharedFrames]) -> None:
    """Request the first view of images that a recording lacks: its error says what is there."""
    for shared in planned:
        for instant, views, modes in shared.captured:
            with renderer_at(renderer, instant) as still:
                recorded = frozenset(still.source.recorded_views() or ())
                alone = [still.plan(camera, pose, job.options) for camera, pose in views]
                plans = planning.share_captures(alone, job.options.sampled(modes))
                sampled = job.options.sampled(modes)
                firsts = (next(plan.rounds(), None) for plan in plans)  # later rounds depend on captures
                requests = (request for first in firsts if first for request in first.requests(sampled))
                missing = (request for request in requests if request.view not in recorded)
                list(still.source.capture(islice(missing, 1)))


def _missing_modes(name: str, missing: list[str], job: Job) -> ArgumentError:
    wanted = f"expected modes with {', '.join(missing)}"
    return ArgumentError(f"{name}: {wanted}, got {', '.join(job.modes)}; add them to 'modes'")


@dataclass(frozen=True)
class Contents:
    """What a dataset holds beyond images: a job's recipe with its names looked up.

    Attributes:
        classes: rules that give objects classes; None for no layer ``classes``.
        truth: options of the truths to derive, by name.
        exports: the formats to write at the end.
        truth_cameras: by truth, the cameras that were named for it; it is derived for no others.
    """

    classes: ClassRules | None = None
    truth: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    exports: tuple[Export, ...] = ()
    truth_cameras: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, job: Job) -> Contents:
        """Return the contents of a job's dataset; in a world that moves, with the poses of objects."""
        recipe = job.recipe
        given = mapping("truth", recipe.truth or {}, (*truths.names(), "tolerance"))
        truth = {name: dict(given[name]) for name in truths.names() if name in given}
        if job.moves or (job.vary is not None and job.vary.objects):
            truth.setdefault("poses", {})
        cameras = {
            name: texts(f"truth.{name}.cameras", options.pop("cameras"))
            for name, options in truth.items()
            if "cameras" in options
        }
        exports = list(recipe.exports)
        for name in [name for name in truth if truths.get(name).format]:  # truths between frames
            format = truths.get(name).format
            options = truth.pop(name)
            if not any(export["format"] == format for export in exports):
                exports.append({"format": format})
            exports = [export | options if export["format"] == format else export for export in exports]
        shared = {
            "tolerance": given.get("tolerance"),
            "sensor": None if job.sensor is None else job.sensor.to_dict(),
        }
        return cls(
            classes=None if recipe.classes is None else class_rules(recipe.classes),
            truth={name: _taken(truths.get(name), shared) | options for name, options in truth.items()},
            exports=tuple(_export(keys, shared) for keys in exports),
            truth_cameras=cameras,
        )

    def kinds(self, job: Job) -> frozenset[str]:
        """Return the kinds of files that every frame has: layers, and records of truths."""
        rows = [modalities.get(mode) for mode in job.modes]
        kinds = {IMAGE, *job.modes, *(layer for row in rows for layer in row.derives)}
        kinds |= {row.marked_by for row in rows if row.marked_by}
        if job.sensor is not None:
            kinds |= {"sensor"} | ({"raw"} if job.sensor.mosaic != "none" else set())
        if self.classes is not None and "labels" in kinds:
            kinds.add("classes")
        if job.imu is not None:
            kinds.add("imu")
        return frozenset(kinds | {truths.get(name).kind for name in self.truth})

    def settings(self, job: Job) -> dict[str, Any]:
        """Return what the manifest holds of a job: all that its frames depend on, but addresses and paths."""
        options = {"modes": list(job.modes), **asdict(job.options), "image_format": job.image_format}
        vary, *of_worlds = (world.vary and asdict(world.vary) for world in job.each)
        others = {world.world: of for world, of in zip(job.worlds[1:], of_worlds, strict=False) if of != vary}
        further = {
            "store": None if job.store == "files" else job.store,
            "depth_format": None if job.depth_format == "exr" else job.depth_format,
            "exposure": None if job.exposure == Exposure() else asdict(job.exposure),
            "brackets": list(job.brackets) or None,
            "watch": job.recipe.watch,
            "sensor": None if job.sensor is None else job.sensor.to_dict(),
            "imu": None if job.imu is None else job.imu.to_dict(),
            "worlds": {world.world: world.world_split for world in job.worlds} or None,
            "vary": vary,
            "vary_of_worlds": others or None,
        }
        options |= {key: value for key, value in further.items() if value is not None}
        named = {name: {"cameras": list(cameras)} for name, cameras in self.truth_cameras.items()}
        options["truth"] = {name: {**truth, **named.get(name, {})} for name, truth in self.truth.items()}
        options["media"] = dict(job.recipe.media or {})
        return {
            "splits": None if job.recipe.split is None else job.recipe.split.to_dict(),
            "exports": [asdict(export) for export in self.exports],
            "options": options,
        }


def _export(keys: Mapping[str, Any], shared: Mapping[str, Any]) -> Export:
    options = {key: value for key, value in keys.items() if key not in ("format", "out", "cameras")}
    with within("export"):
        taken = _taken(exporting.get(keys["format"]), shared)
        return Export(keys["format"], keys.get("out", ""), taken | options, keys.get("cameras", ()))


def _taken(taker: object, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a job that a truth or format takes among its options: its ``keys``."""
    return {key: shared[key] for key in getattr(taker, "keys", ()) if shared.get(key) is not None}


def split_warnings(split: Split, frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line if frames are not divided as a split asks for: places and worlds are not divided."""
    counts = Counter(frame.split for frame in frames)
    off = (abs(counts[name] / len(frames) - share) for name, share in split.shares.items() if frames)
    if max(off, default=0) > _SPLIT_OFF:
        got = ", ".join(
            f"{name} {counts[name]} frames, {counts[name] / len(frames):.0%} ({share:.0%} asked)"
            for name, share in split.shares.items()
        )
        units = len({frame.world if split.by == "world" else frame.place for frame in frames})
        advice = "; give a smaller split.distance_m" if split.by == "place" else ""
        yield f"split: {got}: they are of {units} {split.by}s, and {split.by}s are not divided{advice}"
