"""A job: the images that a user wants, as data. Read from YAML, or made from options.

::

    source: mock://four-wall            # or unreal://host:port, a recording, or a list: replicas of one game
    record: kitchen.sqlite              # optional: captures are kept here, and taken from here
    cameras:                            # stem of the files: model and parameters
      fisheye: {model: fisheye-equidistant, width: 1024, height: 1024, fov_deg: 185}
    poses:                              # metres and degrees; yaw to the left +, nose up +
      - {position: [0, 0, 1.5], yaw_deg: 90}
    modes: [lit, object_mask, depth]
    out: images                         # folder, relative to this file
    strategy: auto                      # and the other options of omniscv.RenderOptions
    image_format: png                   # or jxl, jpg
    source_options: {timeout_s: 60}     # as omniscv.open_source

``poses`` may also name a trajectory file: see ``omniscv.geometry.trajectory``.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from omniscv import modalities, planning, yaml_text
from omniscv.arguments import Reader, flag, number, numbers, shown, text, texts, whole_number, within
from omniscv.arguments import fields as fields_of
from omniscv.cameras import Camera, from_dict
from omniscv.compose.files import check_format
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Progress, Renderer
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import read_trajectory
from omniscv.planning import CameraRays, Kept, RenderOptions, Round, Task, drive
from omniscv.planning.cost import Cost, cost
from omniscv.sources.base import Request, Source, View
from omniscv.sources.recording import record
from omniscv.sources.registry import SourceOptions, known_capabilities, open_sources, scheme_of

_TICK_S = 1 / 60
"""What a request takes of a live engine, at least; counted where nothing is opened to measure it."""
_PROBES, _PROBE_PX = 3, 16


@dataclass(frozen=True)
class Job:
    """What to render; see the module's text for the fields. ``options`` are those of every image.

    Raises:
        ArgumentError: an unknown mode or image format.
    """

    source: str | tuple[str, ...]
    cameras: Mapping[str, Camera]
    poses: tuple[Pose, ...]
    out: Path
    modes: tuple[str, ...] = ("lit",)
    record: Path | None = None
    options: RenderOptions = field(default_factory=RenderOptions)
    image_format: str = "png"
    source_options: SourceOptions = field(default_factory=SourceOptions)

    def __post_init__(self) -> None:
        object.__setattr__(self, "modes", modalities.chosen(self.modes))
        check_format(self.image_format)

    def __len__(self) -> int:
        return len(self.cameras) * len(self.poses)

    @property
    def sources(self) -> tuple[str, ...]:
        """The addresses of its source: several for replicas."""
        return (self.source,) if isinstance(self.source, str) else self.source

    def open(self) -> Source:
        """Open the job's source, recorded where the job has a file for it. The caller closes it."""
        source = open_sources(self.sources, **self.source_options)
        if self.record is None:
            return source
        try:
            return record(source, self.record)
        except BaseException:
            source.close()
            raise

    def items(self) -> Iterator[tuple[str, Camera, Pose]]:
        """Yield stem, camera and pose of every image, pose by pose."""
        digits = len(str(max(0, len(self.poses) - 1)))
        for i, pose in enumerate(self.poses):
            for name, camera in self.cameras.items():
                yield (f"{name}-{i:0{digits}d}" if len(self.poses) > 1 else name), camera, pose


def run(
    job: Job,
    progress: Callable[[float, int], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> list[Path]:
    """Render a job's images and write them; one is written while the next is composed.

    Args:
        job: what to render.
        progress: called with (images done, images in all); a part of an image is a fraction.
        warn: called with a line for each image that has unsure or occluded pixels.

    Returns:
        The files written.

    Raises:
        OmniscvError: as :func:`omniscv.render`; the images before are on disk, whole.
    """
    written: list[Path] = []
    with job.open() as source, ThreadPoolExecutor(1, thread_name_prefix="save") as saver:
        renderer, saving = Renderer(source), None
        for done, (stem, camera, pose) in enumerate(job.items()):
            part = _part_of(progress, done, len(job))
            image = renderer.render(camera, pose, job.modes, job.options, progress=part)
            if warn:
                for line in _warnings(stem, image):
                    warn(line)
            written += saving.result() if saving else []
            saving = saver.submit(image.save, job.out, stem=stem, image_format=job.image_format)
        written += saving.result() if saving else []
    return written


_WARNINGS = {
    "unsure": "not verified by any capture",
    "occluded": "their optical centres are not visible from the camera position",
}


def _warnings(stem: str, image: OmniImage) -> Iterator[str]:
    for layer, what in _WARNINGS.items():
        if layer in image.layers and (count := np.count_nonzero(image[layer])):
            whole = np.count_nonzero(image.valid)
            yield f"{stem}: {count} of {whole} pixels are {layer}: {what} (see {stem}.{layer}.png)"


def _part_of(progress: Callable[[float, int], None] | None, done: int, total: int) -> Progress | None:
    return progress and (lambda part, whole: progress(done + part / max(1, whole), total))


def capture(job: Job, path: Path, progress: Progress | None = None, *, border_px: int | None = None) -> int:
    """Capture all that a job's images need into a file, without composing them.

    Args:
        job: what the captures are for.
        path: the file; made if it is not there.
        progress: called with (captures done, captures known to be needed).
        border_px: how much wider views are on every side; what the widest filter needs, if not given.

    Returns:
        The number of captures that the job needs.
    """
    needed: dict[Request, None] = {}
    with replace(job, record=path).open() as source:
        source.objects()
        renderer = Renderer(source)
        modes = planning.sampled(job.modes, job.options)

        def capture_round(round_: Round) -> Kept:
            kept, total = [], len(needed.keys() | round_.requests(modes))
            for viewpoint, captures in planning.captured(round_, source, modes, skip=needed):
                needed.update(dict.fromkeys(viewpoint.requests(modes)))
                if viewpoint.keep:
                    kept.append(captures)
                if progress:
                    progress(len(needed), total)
            return kept

        for _, camera, pose in job.items():
            task = renderer.task(camera, pose, job.options, border_px=border_px)
            drive(planning.rounds(task), capture_round)
    return len(needed)


def costs(job: Job, *, measure: bool = False) -> list[Cost]:
    """Return what every strategy would ask of the job's source, side by side, without capturing images.

    A source is opened only where what it can do is not known from its address, or to measure how long
    a request takes; else a request is taken to last one tick of an engine.

    Args:
        job: whose images.
        measure: open the source in any case.
    """
    capabilities = known_capabilities(job.sources[0])
    if capabilities is not None and not measure:
        rays = {camera: CameraRays(camera) for camera in job.cameras.values()}
        tasks = [Task(rays[camera], pose, capabilities, job.options) for _, camera, pose in job.items()]
        seconds_per_request = _TICK_S
    else:
        with replace(job, record=None).open() as source:
            renderer = Renderer(source)
            tasks = [renderer.task(camera, pose, job.options) for _, camera, pose in job.items()]
            seconds_per_request = _request_seconds(source)
    found = []
    for name in planning.names():
        with suppress(ArgumentError):  # the source cannot do it
            found.append(cost(name, tasks, planning.sampled(job.modes, job.options), seconds_per_request))
    return found


def _request_seconds(source: Source) -> float:
    """Seconds that a small capture takes; 0 for a recording, which captures nothing."""
    if source.recorded_views() is not None:
        return 0.0
    size = source.capabilities.image_size or (_PROBE_PX, _PROBE_PX)
    turned = [Pose.from_angles((0, 0, 1.5), yaw_deg=turn) for turn in range(_PROBES)]
    requests = [Request(View(pose, 90.0, *size), "lit") for pose in turned]
    list(source.capture(requests[:1]))  # the first one sets size and field of view
    started = time.perf_counter()
    for request in requests:  # one at a time: a source reads ahead
        list(source.capture([request]))
    return (time.perf_counter() - started) / _PROBES


def load(path: Path) -> Job:
    """Return the job in a YAML file; its paths are relative to the file.

    Raises:
        ArgumentError: the file cannot be read, or a field is unknown, missing or wrong.
    """
    with within(path):
        data = yaml_text.parse(yaml_text.read_text(path))
        given = fields_of("", data, _FIELDS, needed=("source", "cameras", "poses"))
        folder, source = path.parent, given.pop("source")
        for key in ("out", "record"):
            if given.get(key) is not None:
                given[key] = folder / given[key]
        options = {key: given.pop(key) for key in _OPTIONS & given.keys()}
        if isinstance(poses := given.pop("poses"), str):
            poses = read_trajectory(folder / poses)
        return Job(
            source=_addresses(source, folder),
            poses=poses,
            options=RenderOptions(**options),
            **{"out": folder / "out", **given},
        )


def _addresses(source: str | tuple[str, ...], folder: Path) -> str | tuple[str, ...]:
    return _address(source, folder) if isinstance(source, str) else tuple(_address(s, folder) for s in source)


def _address(address: str, folder: Path) -> str:
    """An address whose path, if it has one, is relative to a folder."""
    scheme = scheme_of(address)
    if scheme is None:
        return str(folder / address)
    place, question, options = address.removeprefix(f"{scheme}:").partition("?")
    slashes = "//" if place.startswith("//") else ""
    file = folder / place.removeprefix("//")
    if scheme == "launch" or os.path.isfile(file):
        return f"{scheme}:{slashes}{file}{question}{options}"
    return address


# -- the fields of a job's file: each is read by a function (name, value) ------------------------------


def _source(name: str, value: object) -> str | tuple[str, ...]:
    if not isinstance(value, str | list):
        wanted = "expected an address, a recording, or a list of them"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    return text(name, value) if isinstance(value, str) else texts(name, value)


def _cameras(name: str, value: object) -> dict[str, Camera]:
    if not isinstance(value, dict) or not value:
        wanted = "expected a mapping from file stem to model and parameters"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    found = {}
    for stem, description in value.items():
        if stem != Path(text(f"{name}: stem", stem)).name or stem.startswith("."):
            raise ArgumentError(f"{name}: expected names that can be file names, got {shown(stem)}")
        with within(f"{name}.{stem}"):
            found[stem] = from_dict(description)
    return found


def _poses(name: str, value: object) -> str | tuple[Pose, ...]:
    """The poses, or the name of a trajectory's file."""
    if isinstance(value, str):
        return text(name, value)
    if not isinstance(value, list) or not value:
        wanted = "expected a list of poses or the name of a trajectory file"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    given = [fields_of(f"{name}[{i}]", each, _POSE, needed=("position",)) for i, each in enumerate(value)]
    return tuple(Pose.from_angles(**each) for each in given)


def _source_options(name: str, value: object) -> dict[str, Any]:
    """Options of any opener; those that are known are checked here, the opener checks all."""
    if not isinstance(value, dict):
        raise ArgumentError(f"{name}: expected a mapping from option to value, got {shown(value)}")
    kinds = get_type_hints(SourceOptions)
    return {
        key: _OPTION_READERS[kinds[key]](f"{name}.{key}", each) if key in kinds else each
        for key, each in value.items()
    }


def _record(name: str, value: object) -> str | None:
    return None if value is None else text(name, value)


def _as_given(name: str, value: Any) -> Any:
    """A value that its constructor checks."""
    return value


_OPTIONS = {each.name for each in fields(RenderOptions)}
_OPTION_READERS: dict[object, Reader] = {
    float: partial(number, above=0),
    int: partial(whole_number, least=0),
    bool: flag,
}
_POSE: dict[str, Reader] = {
    "position": partial(numbers, shape=(3,)),
    "yaw_deg": number,
    "pitch_deg": number,
    "roll_deg": number,
}
_FIELDS: dict[str, Reader] = {
    "source": _source,
    "record": _record,
    "cameras": _cameras,
    "poses": _poses,
    "modes": texts,
    "out": text,
    "image_format": text,
    "source_options": _source_options,
} | dict.fromkeys(sorted(_OPTIONS), _as_given)
