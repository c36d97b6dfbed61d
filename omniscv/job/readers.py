"""Readers of the keys of a job that no other module has."""

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from omniscv.arguments import (
    flag,
    number,
    numbers,
    one_of,
    shown,
    stems,
    text,
    texts,
    whole_number,
    within,
    wrong,
)
from omniscv.cameras import Camera, from_dict
from omniscv.cameras.rig import Rig
from omniscv.errors import ArgumentError
from omniscv.job.recipe import plain
from omniscv.modalities import TRANSFERS
from omniscv.records import checked, mapping, optional, record
from omniscv.records import read as read_record
from omniscv.sources.requests import MOST_STOPS
from omniscv.sources.world import exposure_bias
from omniscv.storage import is_url, without_secrets


def read_source(name: str, value: object) -> str | tuple[str, ...]:
    """Return ``value``, an address or a list of addresses.

    ArgumentError, which begins with ``name``, for anything else.
    """
    if not isinstance(value, str | list | tuple):
        raise wrong(name, "an address, a recording, or a list of them", value)
    return text(name, value) if isinstance(value, str) else texts(name, value)


@record
class _CameraFile:
    """A camera in a calibration file of another program."""

    file: str = checked(text)
    name: str | None = checked(optional(text), default=None)
    format: Any = None
    width: int | None = checked(optional(whole_number), default=None)
    height: int | None = checked(optional(whole_number), default=None)

    def load(self) -> Camera:
        """Return the camera; ArgumentError if the file has several and ``name`` is none of them."""
        from omniscv.calibration import load  # slow to load

        sizes = self.width, self.height
        size = None if sizes == (None, None) else sizes
        cameras = load(self.file, self.format, size)  # type: ignore[arg-type]
        if self.name is None and len(cameras) == 1:
            return next(iter(cameras.values()))
        with within(self.file):
            return cameras[one_of("name", self.name, cameras)]


def read_cameras(name: str, value: object) -> dict[str, Camera]:
    """Return the cameras that ``value`` describes by their names; errors begin with ``name``."""
    if not isinstance(value, dict) or not value:
        raise wrong(name, "a mapping from file stem to model and parameters, or to a calibration file", value)
    stems(name, value, dots=True)
    cameras: dict[str, Camera] = {}
    for camera, description in value.items():
        with within(f"{name}.{camera}"):
            if isinstance(description, str):
                description = {"file": description}
            if isinstance(description, Mapping) and "file" in description:
                cameras[camera] = read_record(_CameraFile, description).load()
            else:
                cameras[camera] = from_dict(description)
    return cameras


def read_rig(name: str, value: object) -> Rig:
    """Return the rig of ``value``: the name of a file, or cameras by name. Errors begin with ``name``."""
    if not isinstance(value, str | Mapping):
        raise ArgumentError(f"{name}: expected a file's name or cameras by name, got {shown(value)}")
    from omniscv.calibration import load_rig  # slow to load

    with within(name):
        return load_rig(text("file", value)) if isinstance(value, str) else Rig.from_dict(value)


def read_recording(name: str, value: object) -> Path:
    """Return ``value`` as the path of a recording; ArgumentError, which begins with ``name``, for a URL or a
    folder."""
    if is_url(value):
        wanted = "expected a path on this machine, to be put into a store by 'omniscv recording merge'"
        raise ArgumentError(f"{name}: {wanted}; got {without_secrets(value)}")
    path = Path(text(name, value))
    if os.path.isdir(path):  # Path's own raises where the name is too long
        raise ArgumentError(f"{name}: expected a file or a free name, got a folder: {path}")
    return path


@record
class KnownOptions:
    """Options of sources that are known here; :class:`omniscv.sources.registry.SourceOptions` says more."""

    timeout_s: float = checked(
        number, above=0, default=15.0, help="seconds that connecting, and each reply, may take"
    )
    patience_s: float = checked(
        number, above=0, default=10.0, help="seconds of connecting and sending again after a fault"
    )
    retries: int = checked(whole_number, least=0, default=5, help="how often, with exponential backoff")
    transfer: str | None = checked(
        one_of,
        words=TRANSFERS,
        default=None,
        help="what 8-bit colours say of light: srgb, linear, film or unknown",
    )
    fix_exposure: bool = checked(
        flag, default=False, help="switch off vignette and auto exposure in the running game"
    )
    exposure: Any = checked(
        exposure_bias, default=None, help="exposure of the camera: auto, its bias in stops, or game"
    )
    warmup: int = checked(
        whole_number,
        least=0,
        default=0,
        help="frames of colour to drop after each move, where effects blend them",
    )


def read_source_options(name: str, value: object) -> dict[str, Any]:
    """Return the options of ``value``, of which those that are known here are checked; the opener checks all.

    Errors begin with ``name``.
    """
    options = mapping(name, value)
    if "freeze" in options:
        raise ArgumentError(f"{name}.freeze: expected it as a key of the job, 'freeze: {options['freeze']}'")
    known = {field.name for field in fields(KnownOptions)}
    checked_here = {key: option for key, option in options.items() if key in known}
    return {**options, **plain(name, checked_here, KnownOptions)}


def read_brackets(name: str, value: object) -> tuple[float, ...]:
    """Return the stops of ``value``, in increasing order; none if it is empty. Errors begin with ``name``."""
    stops: list[float] = []
    if isinstance(value, list | tuple) and value:
        stops = numbers(name, value, (None,)).tolist()
    is_long = not value or len(stops) >= 2
    is_wide = any(abs(stop) > MOST_STOPS for stop in stops)
    if not is_long or is_wide or stops != sorted(set(stops)):
        raise wrong(name, f"two or more increasing stops within {MOST_STOPS:g}, such as [-2, 0, 2]", value)
    return tuple(stops)
