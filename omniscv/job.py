"""A job: the images that somebody wants, as data. Read from YAML, or made from options.

::

    source: mock://four-wall            # or unreal://host:port, a recorded file, or a list: several games
    record: kitchen.sqlite              # optional: captures are kept here, and taken from here
    cameras:                            # stem of the files: model and parameters
      fisheye: {model: fisheye-equidistant, width: 1024, height: 1024, fov_deg: 185}
    poses:                              # metres and degrees; yaw to the left +, nose up +
      - {position: [0, 0, 1.5], yaw_deg: 90}
    modes: [lit, object_mask, depth]
    out: images                         # folder, relative to this file
    strategy: auto                      # and viewpoints, face_size, filter, max_error_px: as omniscv.render
    image_format: png                   # or jxl, jpg

``poses`` may also name a trajectory file: see ``omniscv.output.trajectories``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from omniscv.cameras import Camera, from_dict
from omniscv.captures import record
from omniscv.captures.shared import open_shared
from omniscv.captures.source import Source
from omniscv.compose import Composer
from omniscv.compose.layers import Mask
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.output.trajectories import read_trajectory
from omniscv.plan import STRATEGIES, Plan, make_plan
from omniscv.plan.cost import Cost, cost, measure_latency
from omniscv.render import render

_POSE_KEYS = {"position", "yaw_deg", "pitch_deg", "roll_deg"}


@dataclass(frozen=True)
class Job:
    """What to render; see the module's text for the fields."""

    source: str | tuple[str, ...]
    cameras: dict[str, Camera]
    poses: tuple[Pose, ...]
    out: Path
    modes: tuple[str, ...] = ("lit",)
    record: Path | None = None
    strategy: str = "auto"
    viewpoints: int | None = None
    face_size: int | str = "auto"
    filter: str = "auto"
    max_error_px: float | None = None
    image_format: str = "png"
    source_options: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.cameras) * len(self.poses)

    def open(self) -> Source:
        """The job's source, recorded where the job says so. The caller closes it."""
        uris = (self.source,) if isinstance(self.source, str) else self.source
        source = open_shared(uris, **self.source_options)
        if self.record is None:
            return source
        try:
            return record(source, self.record)
        except BaseException:
            source.close()
            raise

    def items(self) -> Iterator[tuple[str, Camera, Pose]]:
        """Stem, camera and pose of every image, pose by pose."""
        digits = len(str(max(0, len(self.poses) - 1)))
        for i, pose in enumerate(self.poses):
            for name, camera in self.cameras.items():
                yield (f"{name}-{i:0{digits}d}" if len(self.poses) > 1 else name), camera, pose

    def plans(self, source: Source, border_px: int | None = None) -> Iterator[Plan]:
        """The plan of every image; views are ``border_px`` wider on every side, if given."""
        for _, camera, pose in self.items():
            yield make_plan(
                camera,
                pose,
                source.capabilities,
                strategy=self.strategy,
                viewpoints=self.viewpoints,
                face_size=self.face_size,
                border_px=border_px,
                recorded=source.recorded_views(),
            )


def run(
    job: Job,
    progress: Callable[[int, int], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> list[Path]:
    """Renders a job's images and writes them.

    Args:
        job: what to render.
        progress: called with (images done, images in all).
        warn: called with a line for each image that has unsure pixels.

    Returns:
        The files written.

    Raises:
        OmniscvError: as :func:`omniscv.render`; the images before are on disk, whole.
    """
    written: list[Path] = []
    composer = Composer()
    with job.open() as source, ThreadPoolExecutor(1, thread_name_prefix="save") as saver:
        saving: Future[list[Path]] | None = None  # one image is written while the next is composed
        for done, (stem, camera, pose) in enumerate(job.items()):
            if progress:
                progress(done, len(job))
            image = render(
                camera,
                pose,
                source,
                job.modes,
                strategy=job.strategy,
                viewpoints=job.viewpoints,
                face_size=job.face_size,
                filter=job.filter,
                max_error_px=job.max_error_px,
                composer=composer,
            )
            if warn and image.unsure is not None and image.unsure.any():
                warn(f"{stem}: {_doubt(image.unsure, image.valid)} (see {stem}.unsure.png)")
            if saving:
                written += saving.result()
            saving = saver.submit(image.save, job.out, stem=stem, image_format=job.image_format)
        if saving:
            written += saving.result()
    if progress:
        progress(len(job), len(job))
    return written


def _doubt(unsure: Mask, valid: Mask) -> str:
    count = f"{np.count_nonzero(unsure)} of {np.count_nonzero(valid)} pixels"
    return f"{count} are unsure: their optical centre is not in the open, or no capture verified them"


def capture(
    job: Job,
    path: Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    border_px: int | None = None,
) -> int:
    """Captures all that a job's images need into a file, without composing them.

    Args:
        job: what the captures are for.
        path: the file; made if it is not there.
        progress: called with (captures done, captures in all).
        border_px: how much wider views are on every side; what the widest filter needs, if not given.

    Returns:
        The number of captures that the job needs.
    """
    with replace(job, record=path).open() as source:
        source.objects()
        requests = dict.fromkeys(
            request for plan in job.plans(source, border_px) for request in plan.requests(job.modes)
        )
        for done, _ in enumerate(source.capture(requests), start=1):
            if progress:
                progress(done, len(requests))
    return len(requests)


def costs(job: Job) -> list[Cost]:
    """What every strategy would ask of the job's source, side by side, without capturing anything."""
    found = []
    with replace(job, record=None).open() as source:
        latency_s = measure_latency(source)
        for strategy in STRATEGIES:
            try:
                plans = list(replace(job, strategy=strategy).plans(source))
            except ArgumentError:
                continue  # the source cannot do it
            found.append(cost(strategy, plans, job.modes, latency_s))
    return found


def load(path: Path) -> Job:
    """The job in a YAML file; its paths are relative to the file.

    Raises:
        ArgumentError: the file cannot be read, or a field is unknown, missing or wrong.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as cause:
        raise ArgumentError(f"{path}: expected a job in YAML, got {type(cause).__name__}: {cause}") from cause
    if not isinstance(data, dict):
        raise ArgumentError(
            f"{path}: expected a job in YAML with 'source', 'cameras' and 'poses'; got {data!r}"
        )
    known = {f.name for f in fields(Job)}
    if unknown := sorted(set(data) - known):
        raise ArgumentError(f"{path}: expected fields among {', '.join(sorted(known))}; got {unknown[0]!r}")
    if missing := [key for key in ("source", "cameras", "poses") if key not in data]:
        raise ArgumentError(f"{path}: expected a field {missing[0]!r}, which is missing")
    folder = path.parent
    record_path = data.get("record")
    return Job(
        **{
            **data,
            "source": _source(data["source"], folder),
            "cameras": _cameras(data["cameras"]),
            "poses": _poses(data["poses"], folder),
            "modes": tuple(data.get("modes", ("lit",))),
            "out": folder / data.get("out", "out"),
            "record": None if record_path is None else folder / record_path,
        }
    )


def _source(value: Any, folder: Path) -> str | tuple[str, ...]:
    if isinstance(value, list) and value and all(isinstance(each, str) for each in value):
        return tuple(_address(each, folder) for each in value)
    if not isinstance(value, str):
        raise ArgumentError(f"source: expected an address, a recorded file, or a list of them, got {value!r}")
    return _address(value, folder)


def _address(text: str, folder: Path) -> str:
    if text.startswith("launch:"):
        return f"launch:{folder / text.removeprefix('launch:')}"
    return text if "://" in text else str(folder / text)


def _cameras(value: Any) -> dict[str, Camera]:
    if not isinstance(value, dict) or not value:
        raise ArgumentError(
            f"cameras: expected a mapping from file stem to model and parameters, got {value!r}"
        )
    for stem in value:
        if not isinstance(stem, str) or stem != Path(stem).name or stem.startswith("."):
            raise ArgumentError(f"cameras: expected names that can be file names, got {stem!r}")
    return {stem: from_dict(description) for stem, description in value.items()}


def _poses(value: Any, folder: Path) -> tuple[Pose, ...]:
    if isinstance(value, str):
        return read_trajectory(folder / value)
    if not isinstance(value, list) or not value:
        raise ArgumentError(
            f"poses: expected a list of poses or the name of a trajectory file, got {value!r}"
        )
    for pose in value:
        if not isinstance(pose, dict) or "position" not in pose or not set(pose) <= _POSE_KEYS:
            raise ArgumentError(f"poses: expected mappings of {', '.join(sorted(_POSE_KEYS))}; got {pose!r}")
    return tuple(Pose.from_angles(**pose) for pose in value)
