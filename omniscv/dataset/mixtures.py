"""Find frames that do not belong together: a line for each contradiction among them, or with the manifest."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from omniscv import modalities
from omniscv.dataset.manifest import Manifest
from omniscv.frame import Frame
from omniscv.geometry import Array

_NUMBER = re.compile(r"(.*)-([0-9]+)")
_POSITION = re.compile(r"-?[0-9]+\.[0-9]{3}(,-?[0-9]+\.[0-9]{3}){2}")
"""The name of a place that its first pose gives it."""
_SLACK_M = 1e-6  # of distances that are compared


def mixed(whole: Manifest, frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line for each mixture in the ``frames`` of a dataset with the manifest ``whole``."""
    yield from _kinds(whole, frames)
    if "modes" in whole.settings.get("options", {}):  # of a job
        yield from _scenes(frames)
        yield from _numbers(whole, frames)
    yield from _times(frames)
    yield from _near_places(whole, frames)


def _scenes(frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line for each world whose frames are of several scenes."""
    first: dict[str, Frame] = {}
    reported = set()
    for frame in frames:
        other = first.setdefault(frame.world, frame)
        if frame.scene != other.scene and frame.world not in reported:
            reported.add(frame.world)
            wanted = f"expected the scene of {other.key}, {other.scene or 'none'}"
            yield f"{frame.key}: {wanted}, got {frame.scene or 'none'}: frames of several worlds are mixed"


def _kinds(whole: Manifest, frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line for each frame that has other layers than the dataset's modes and classes give it."""
    modes = whole.settings.get("options", {}).get("modes")
    captured = set(modalities.names())
    suffixes: dict[str, tuple[str, str]] = {}
    for frame in frames:
        kinds = {*frame.files, *frame.blank}
        if modes is not None and (differ := sorted((kinds & captured) ^ set(modes))):
            wanted = f"expected the modes {', '.join(modes)} of the dataset"
            yield f"{frame.key}: {wanted}; {', '.join(differ)} is missing, or beside them"
        if ("classes" in kinds) != (whole.rules is not None and "labels" in kinds):
            wanted = "expected classes in the frames with labels" if whole.rules else "expected no classes"
            yield f"{frame.key}: {wanted}, as the dataset has {'some' if whole.rules else 'none'}"
        for kind, entry in frame.entries.items():
            suffix = entry.path.rpartition(".")[2]
            before, key = suffixes.setdefault(kind, (suffix, frame.key))
            if suffix != before:
                yield f"{entry.path}: expected a .{before} file, as {key} has, got a .{suffix} file"


def _numbers(whole: Manifest, frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line for each camera of a job whose frames are not numbered as the poses of one job are."""
    digits: dict[tuple[str, str], tuple[int, str]] = {}
    reported = set()
    worlds = {} if whole.origin is None else whole.origin.worlds
    for frame in frames:
        match = _NUMBER.fullmatch(frame.key)
        name = (frame.world, frame.camera_name)
        number = match[2] if match else ""
        count, key = digits.setdefault(name, (len(number), frame.key))
        if len(number) != count and name not in reported:
            reported.add(name)
            yield f"{frame.key}: expected as many digits as {key} has: frames of several jobs are mixed"
        poses = worlds.get(frame.world, {}).get("poses")
        most = poses.get("count") if isinstance(poses, Mapping) else None
        if isinstance(most, int) and number and int(number) >= most and name not in reported:
            reported.add(name)
            yield f"{frame.key}: expected one of the {most} poses of the job, got a frame of another job"


def _times(frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line for each camera with two frames of one time, one pose and one state of the world."""
    seen: dict[tuple[object, ...], str] = {}
    reported = set()
    for frame in frames:
        if frame.time_ns is None:
            continue
        name = (frame.world, frame.camera_name)
        shown = (frame.time_ns, str(frame.pose.to_dict()), str(frame.varied))
        key = seen.setdefault((*name, *shown), frame.key)
        if key != frame.key and name not in reported:
            reported.add(name)
            wanted = f"expected another time or pose than that of {key}, of the same camera"
            yield f"{frame.key}: {wanted}, got the same"


def _near_places(whole: Manifest, frames: Sequence[Frame]) -> Iterator[str]:
    """Yield a line if frames of two splits are nearer to each other than places are."""
    from scipy.spatial import cKDTree  # slow to load

    splits = whole.settings.get("splits")
    if not splits or splits.get("by") != "place":
        return

    keys: dict[tuple[str, str], list[str]] = defaultdict(list)
    positions: dict[tuple[str, str], list[Array]] = defaultdict(list)  # metres, world frame
    for frame in frames:
        if frame.split and _POSITION.fullmatch(frame.place.rpartition("/")[2]):
            keys[frame.world, frame.split].append(frame.key)
            positions[frame.world, frame.split].append(frame.pose.position)
    for world, split in positions:
        tree = cKDTree(np.array(positions[world, split]))
        for other_world, other in positions:
            if world != other_world or split >= other:
                continue
            found = tree.query(np.array(positions[world, other]))
            metres = np.atleast_1d(found[0])
            nearest = np.atleast_1d(found[1])
            closest = int(np.argmin(metres))
            if metres[closest] < splits["distance_m"] - _SLACK_M:
                key = keys[world, split][nearest[closest]]
                pair = f"{keys[world, other][closest]} of {other}, {key} of {split}"
                wanted = f"expected places {splits['distance_m']:g} m apart in different splits"
                yield f"{pair}: {wanted}, got {metres[closest]:.3g} m"
