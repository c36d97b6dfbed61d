"""The file of a job: YAML, checked field by field.

::

    source: mock://four-wall            # or unreal://host:port, a recording, or a list: replicas of one game
    record: kitchen.sqlite              # optional: captures are kept here, and taken from here
    cameras:                            # stem of the files: model and parameters
      fisheye: {model: fisheye-equidistant, width: 1024, height: 1024, fov_deg: 185}
    poses:                              # metres and degrees; yaw to the left +, nose up +
      - {position: [0, 0, 1.5], yaw_deg: 90}  # and, for datasets, time: seconds, place: NAME
    modes: [lit, object_mask, depth]
    out: images                         # folder, relative to this file; a dataset's may be s3://bucket/images
    strategy: auto                      # and the other options of omniscv.RenderOptions
    image_format: png                   # or jxl, jpg
    source_options: {timeout_s: 60}     # as omniscv.open_source
    rig: camchain.yaml                  # with cameras or in their place: see omniscv.jobs.rigs
    motions: {Ball: ball.tum}           # what moves, and times: see omniscv.jobs.motions
    freeze: auto                        # how a live world is kept still, as omniscv.open_source
    exposure: {seconds: 0.02, instants: 9}  # motion blur: see omniscv.jobs.moments

``poses`` may also name a trajectory file: see ``omniscv.geometry.trajectory``. The keys that datasets have
beyond these are in :mod:`omniscv.dataset.recipe`.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_type_hints

from omniscv.arguments import Reader, flag, number, one_of, shown, text, texts, whole_number, within
from omniscv.arguments import fields as fields_of
from omniscv.cameras import Camera, from_dict
from omniscv.dataset import recipe
from omniscv.errors import ArgumentError
from omniscv.jobs import motions, poses
from omniscv.jobs.job import Job
from omniscv.jobs.moments import Exposure
from omniscv.jobs.overriding import overridden
from omniscv.jobs.rigs import read_rig, rig_of
from omniscv.planning import RenderOptions
from omniscv.sources.registry import SourceOptions, scheme_of
from omniscv.sources.world import Freeze
from omniscv.storage import bounded, is_url, without_secrets

EXAMPLE = Path(__file__).parent / "example.yaml"
"""A job with every key, and a comment for each."""


def load(path: Path, overrides: Mapping[str, Any] | None = None) -> Job:
    """Return the job in a YAML file; its paths are relative to the file.

    Args:
        path: of the file.
        overrides: values in place of the file's, as :func:`omniscv.jobs.overriding.overridden` takes them.

    Raises:
        ArgumentError: the file cannot be read, or a field is unknown, missing or wrong.
    """
    with within(path):
        data = bounded.parse_yaml(bounded.read_text(path))
        return read(overridden(data, overrides or {}), path.parent)


def read(description: object, folder: Path) -> Job:
    """Return the job that a mapping of the same keys describes; its paths are relative to a folder.

    Raises:
        ArgumentError: a field is unknown, missing or wrong.
    """
    given = fields_of("", description, FIELDS, needed=("source", "poses"))
    source, given_poses = given.pop("source"), given.pop("poses")
    for key in ("out", "record"):
        if given.get(key) is not None and not (key == "out" and is_url(given[key])):
            given[key] = folder / given[key]
    options = {key: given.pop(key) for key in _OPTIONS & given.keys()}
    given["rig"] = rig_of(given.get("rig"), folder)
    given["motions"] = motions.opened(given.get("motions", {}), folder)
    if "freeze" in given:
        freeze = {"freeze": given.pop("freeze")}
        given["source_options"] = {**given.get("source_options", {}), **freeze}
    times = given.pop("times", None)
    posed = motions.timed(poses.opened(given_poses, folder), times)
    recipe_of = {key: given.pop(key) for key in recipe.FIELDS if key in given}
    return Job(
        source=address(source, folder),
        options=RenderOptions(**options),
        recipe=recipe.read(recipe_of, folder),
        **{"out": folder / "out", "cameras": {}, **given},
        **posed._asdict(),
        clock=times is not None,
    )


def address(source: str | Sequence[str], folder: Path) -> str | tuple[str, ...]:
    """Return an address, or several, whose paths, if they have any, are relative to a folder."""
    return _address(source, folder) if isinstance(source, str) else tuple(_address(s, folder) for s in source)


def _address(address: str, folder: Path) -> str:
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
    if not isinstance(value, str | list | tuple):
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
    if is_url(value):
        wanted = "expected a path on this machine, to be put into a store by 'omniscv captures merge'"
        raise ArgumentError(f"{name}: {wanted}; got {without_secrets(value)}")
    return None if value is None else text(name, value)


def _as_given(name: str, value: Any) -> Any:
    """A value that its constructor checks."""
    return value


def _freeze(name: str, value: object) -> Freeze:
    found: Freeze = one_of(name, value, get_args(Freeze))
    return found


_OPTIONS = {each.name for each in fields(RenderOptions)}
_OPTION_READERS: dict[object, Reader] = {
    float: partial(number, above=0),
    int: partial(whole_number, least=0),
    bool: flag,
    Freeze: _freeze,
}
FIELDS: dict[str, Reader] = {
    "source": _source,
    "record": _record,
    "cameras": _cameras,
    "poses": poses.read,
    "modes": texts,
    "out": text,
    "image_format": text,
    "source_options": _source_options,
    "rig": read_rig,
    "motions": motions.read,
    "times": motions.read_times,
    "freeze": _freeze,
    "exposure": Exposure.read,
    **recipe.FIELDS,
} | dict.fromkeys(sorted(_OPTIONS), _as_given)
