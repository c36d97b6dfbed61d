"""Check a job before anything is captured, and look up what its dataset holds."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
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
from omniscv.planning import Plan
from omniscv.planning.viewpoints import MEAN_OF_A_FACE
from omniscv.progress import in_phase
from omniscv.records import mapping
from omniscv.sources.base import Request, Source, check_modes, known_objects
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
    if job.record is not None and job.options.color_rays not in ("auto", 0):
        expected = "expected auto or 0 beside record, since a recording holds no rays"
        raise ArgumentError(f"color_rays: {expected}; got {job.options.color_rays}")
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
    if job.recipe.watch:
        _require_kinds("watch", ("object_mask", "depth"), kinds, job)
    for name, cameras in contents.truth_cameras.items():
        for camera in cameras:
            one_of(f"truth.{name}.cameras", camera, job.cameras)
    for name, options in contents.truth.items():
        truth = truths.get(name)
        _require_kinds(f"truth.{name}", truth.needs, kinds, job)
        with within(f"truth.{name}"):
            truth.read_options(options)
    folders: set[str] = set()
    for export in contents.exports:
        if export.out in folders:
            raise ArgumentError(f"export: expected different folders, got {export.out!r} twice; set 'out'")
        folders.add(export.out)
        export.check(job.cameras, kinds)
    return contents


def _require_kinds(key: str, needs: Sequence[str], kinds: Collection[str], job: Job) -> None:
    """Raise ArgumentError, which begins with a key of the job, for needs that are none of some kinds."""
    missing = [mode for mode in needs if mode not in kinds]
    if missing:
        raise _missing_modes(key, missing, job)


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
            contents.append(check_dataset(world) if dataset else check(world))
            _check_files(world, job)
    check_keys(job)
    _check_out(job)
    worlds = list(job.each)
    planned = list[SharedFrames]()
    for number, world in enumerate(in_phase("checking worlds", job.each)):
        if "launch" in map(scheme_of, world.sources):
            continue
        to_open = opens(world) if opens else replace(world, record=None)
        with of_world(world):
            try:
                known, frames = _plan_world(to_open, contents[number] if dataset else Contents())
            except (SourceError, RecordingError):
                if not job.failures.skip:
                    raise
            else:
                worlds[number] = replace(known, draws=None, record=world.record)
                planned += frames
    check_faults(job, planned)
    return replace(job, worlds=tuple(worlds)) if job.worlds else worlds[0]


def _plan_world(world: Job, contents: Contents) -> tuple[Job, list[SharedFrames]]:
    """Open a world, and return it with its poses, and its frames; refuse what its source cannot give."""
    with opened(world) as (known, source):
        frames = list(frames_by_instant(known))
        check_source(known, contents, Renderer(source), frames)
        return known, frames


def _check_out(job: Job) -> None:
    """Refuse a file as the folder of a job."""
    if not is_url(job.out) and os.path.exists(job.out) and not os.path.isdir(job.out):
        raise ArgumentError(f"out: expected a folder or a free name, got a file: {job.out}")


def _check_files(world: Job, job: Job) -> None:
    """Refuse a world of a job whose ``record`` is no recording, or whose packaged game does not exist."""
    if world.record is not None:
        record = target_of(world.record)
        if os.path.isfile(record) and os.path.getsize(record):
            Store(record).close()  # refuses a file that is no recording
        if os.path.isdir(record) or str(record) == os.path.abspath(job.out):
            raise ArgumentError(f"record: expected a file such as room.sqlite, got a folder: {record}")
    for address in world.sources:
        if scheme_of(address) == "launch":
            path = address.partition(":")[2].removeprefix("//").partition("?")[0]
            if not os.path.isfile(path):
                raise ArgumentError(f"source: expected the file of a game, got none at {path}")


def check_faults(job: Job, planned: Iterable[SharedFrames]) -> None:
    """Refuse a ``job`` if more of its ``planned`` frames have a fault than may fail.

    Such frames are known before any capture: no pose, or no draw, was found for them.
    """
    faults = [shared for shared in planned if shared.fault]
    count = sum(len(shared.frames) for shared in faults)
    if count > job.failures.skip * sum(map(frame_count, job.each)):
        key = faults[0].frames[0].key
        raise ArgumentError(f"{key}, at {faults[0].frames[0].place}: {faults[0].fault}")


def frame_count(world: Job) -> int:
    """Return the number of a world's frames; of sampled poses, as far as it is known before."""
    return len(world) or len(world.cameras) * getattr(world.sampling, "count", 0)


def check_source(job: Job, contents: Contents, renderer: Renderer, planned: Sequence[SharedFrames]) -> None:
    """Refuse a job that its open source cannot give, before anything is captured or written.

    Args:
        job: with its poses.
        contents: of its dataset; empty for images alone.
        renderer: of the open source.
        planned: the frames; of a recording, their first views must be there.
    """
    modes = job.options.sampled(job.modes)
    source = renderer.source
    check_modes(source, modes)
    if job.motions:
        known_objects(job.motions, source.objects().names(), "motions")
    if job.options.sky:
        known_objects(job.options.sky, source.objects().names(), "sky")
    if contents.classes is not None:
        contents.classes.table(source.objects().names())
    needs_geometry = any(truths.get(name).check for name in contents.truth)
    geometry = source.geometry() if needs_geometry else SceneGeometry()
    for name, options in contents.truth.items():
        truth = truths.get(name)
        if truth.check is not None:
            with within(f"truth.{name}"):
                truth.check(source, geometry, modes, truth.read_options(options))
    check_face_size(job, source)
    if job.poses:
        _check_plans(job, renderer, modes)
    if source.recorded_views() is not None:
        _check_recorded(job, renderer, planned)


def _check_plans(job: Job, renderer: Renderer, modes: tuple[str, ...]) -> None:
    """Refuse an accuracy of no use, budgets below what the first captures of an image take, and colours by
    rays that the source or the strategy does not have."""
    options = job.options
    has_budget = options.most_captures is not None or options.most_megapixels is not None
    if not has_budget and options.accuracy is None and options.color_rays in ("auto", 0):
        return
    for name, camera in job.cameras.items():
        pose = job.own_poses.get(name, job.poses)[0]
        plan = replace(renderer.plan(camera, pose, options), modes=modes).by_rays()
        if plan.doubt_share is not None and has_budget:
            plan.make(plan.modes)


def check_face_size(job: Job, source: Source) -> None:
    """Refuse the ``face_size`` of a ``job`` if its ``source`` is a recording of other sizes."""
    wanted = job.options.face_size
    views = source.recorded_views() or ()
    if wanted == "auto" or not views:
        return
    sizes = set()
    squares = set()
    for view in views:
        size = round(2 * view.focal_px)
        sizes.add(size)
        if view.width == view.height:
            squares.add(size)
    usable = set()
    for scale in (1, job.options.truth_scale):
        usable.add(round(scale * wanted))
        usable.add(round(scale * wanted * MEAN_OF_A_FACE))
    if sizes.isdisjoint(usable):
        listed = " or ".join(map(str, sorted(squares or sizes)))
        raise ArgumentError(f"face_size: expected {listed} px, as the recording has, or auto; got {wanted}")


def _check_recorded(job: Job, renderer: Renderer, planned: Sequence[SharedFrames]) -> None:
    """Request the first view of images that a recording lacks: its error says what it has."""
    for shared in in_phase("looking for captures", planned):
        for instant, views, modes in shared.captured:
            with renderer_at(renderer, instant) as still:
                recorded = frozenset(still.source.recorded_views() or ())
                alone = [still.plan(camera, pose, job.options) for camera, pose in views]
                for request in _first_requests(alone, job.options.sampled(modes)):
                    if request.view not in recorded:
                        list(still.source.capture([request]))
                        break


def _first_requests(plans: Sequence[Plan], modes: tuple[str, ...]) -> Iterator[Request]:
    """Yield the requests of the first rounds of plans that share captures: later ones depend on captures."""
    for plan in planning.share_captures(plans, modes):
        first = next(plan.rounds(), None)
        if first:
            yield from first.requests(modes)


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
        shared = {"tolerance": given.get("tolerance")}
        if job.sensor is not None:
            shared["sensor"] = job.sensor.to_dict()
        options_of = _truth_options(job, given)
        cameras = {}
        for name, options in options_of.items():
            if "cameras" in options:
                cameras[name] = texts(f"truth.{name}.cameras", options.pop("cameras"))
        exports = list(recipe.exports)
        truth = {}
        for name, options in options_of.items():
            known = truths.get(name)
            if known.format:  # a truth between frames is an export
                exports = _with_options(exports, known.format, options)
            else:
                truth[name] = _taken(known, shared) | options
        return cls(
            classes=None if recipe.classes is None else class_rules(recipe.classes),
            truth=truth,
            exports=tuple(_export(keys, shared) for keys in exports),
            truth_cameras=cameras,
        )

    def kinds(self, job: Job) -> frozenset[str]:
        """Return the kinds of files that every frame has: layers, and records of truths."""
        kinds = {IMAGE, *job.modes}
        for modality in map(modalities.get, job.modes):
            kinds.update(modality.derives)
            if modality.marked_by:
                kinds.add(modality.marked_by)
        if job.sensor is not None:
            kinds.add("sensor")
            if job.sensor.mosaic != "none":
                kinds.add("raw")
        if self.classes is not None and "labels" in kinds:
            kinds.add("classes")
        if job.imu is not None:
            kinds.add("imu")
        for name in self.truth:
            kinds.add(truths.get(name).kind)
        return frozenset(kinds)

    def settings(self, job: Job) -> dict[str, Any]:
        """Return what the manifest holds of a job: all that its frames depend on, but addresses and paths."""
        truth = {}
        for name, options in self.truth.items():
            truth[name] = dict(options)
            if name in self.truth_cameras:
                truth[name]["cameras"] = list(self.truth_cameras[name])
        options = {
            "modes": list(job.modes),
            **asdict(job.options),
            "image_format": job.image_format,
            **_settings_of_files(job),
            **_settings_of_worlds(job),
            "truth": truth,
            "media": dict(job.recipe.media or {}),
        }
        return {
            "splits": None if job.recipe.split is None else job.recipe.split.to_dict(),
            "exports": list(map(asdict, self.exports)),
            "options": options,
        }


def _truth_options(job: Job, given: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the options of a job's truths by name; in a world that moves, of poses of objects, too."""
    options_of: dict[str, dict[str, Any]] = {}
    for name in truths.names():
        if name in given:
            options_of[name] = dict(given[name])
    if job.moves or (job.vary is not None and job.vary.objects):
        options_of.setdefault("poses", {})
    return options_of


def _settings_of_files(job: Job) -> dict[str, Any]:
    """Return the settings of a job's files, exposure and rig that are not their defaults."""
    settings: dict[str, Any] = {}
    if job.store != "files":
        settings["store"] = job.store
    if job.depth_format != "exr":
        settings["depth_format"] = job.depth_format
    if job.exposure != Exposure():
        settings["exposure"] = asdict(job.exposure)
    if job.brackets:
        settings["brackets"] = list(job.brackets)
    if job.recipe.watch is not None:
        settings["watch"] = job.recipe.watch
    if job.sensor is not None:
        settings["sensor"] = job.sensor.to_dict()
    if job.imu is not None:
        settings["imu"] = job.imu.to_dict()
    return settings


def _settings_of_worlds(job: Job) -> dict[str, Any]:
    """Return the splits of a job's worlds, what varies in the first, and in others if it is not the same."""
    settings: dict[str, Any] = {}
    if job.worlds:
        settings["worlds"] = {world.world: world.world_split for world in job.worlds}
    first, *others = job.each
    vary = _vary_of(first)
    if vary is not None:
        settings["vary"] = vary
    different = {}
    for world in others:
        other_vary = _vary_of(world)
        if other_vary != vary:
            different[world.world] = other_vary
    if different:
        settings["vary_of_worlds"] = different
    return settings


def _vary_of(world: Job) -> dict[str, Any] | None:
    return None if world.vary is None else asdict(world.vary)


def _with_options(
    exports: Sequence[Mapping[str, Any]], format: str, options: Mapping[str, Any]
) -> list[Mapping[str, Any]]:
    """Return exports with options added to those of a format, or to a new one if there is none."""
    extended: list[Mapping[str, Any]] = []
    is_new = True
    for export in exports:
        if export["format"] == format:
            is_new = False
            export = {**export, **options}
        extended.append(export)
    if is_new:
        extended.append({"format": format, **options})
    return extended


def _export(keys: Mapping[str, Any], shared: Mapping[str, Any]) -> Export:
    """Return the export that a job describes; ``shared`` are keys of the job that its format may take."""
    options = dict(keys)
    format = options.pop("format")
    out = options.pop("out", "")
    cameras = options.pop("cameras", ())
    with within("export"):
        taken = _taken(exporting.get(format), shared)
        return Export(format, out, taken | options, cameras)


def _taken(taker: object, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a job that a truth or format takes among its options: its ``keys``."""
    taken = {}
    for key in getattr(taker, "keys", ()):
        if shared.get(key) is not None:
            taken[key] = shared[key]
    return taken


def split_warnings(split: Split, frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line if ``frames`` are not divided as a ``split`` asks: places and worlds stay whole."""
    if not frames:
        return
    counts = Counter(frame.split for frame in frames)
    most_off = 0.0
    shares = []
    for name, share in split.shares.items():
        actual = counts[name] / len(frames)
        most_off = max(most_off, abs(actual - share))
        shares.append(f"{name} {counts[name]} frames, {actual:.0%} ({share:.0%} asked)")
    if most_off > _SPLIT_OFF:
        units = len({getattr(frame, split.by) for frame in frames})  # its world or its place
        advice = "; give a smaller split.distance_m" if split.by == "place" else ""
        found = f"they are of {units} {split.by}s, and {split.by}s are not divided"
        yield f"split: {', '.join(shares)}: {found}{advice}"
