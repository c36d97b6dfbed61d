"""Ask a dataset's pictures whether the poses of its exports are in the convention that their formats have."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import yaml

from omniscv import dataset, storage
from omniscv.arguments import one_of
from omniscv.dataset.checking import local_copy
from omniscv.dataset.exporting import EXPORTS
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.geometry.trajectory_columns import Rows
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.importing.conventions import PAIRS, WIDTH, Verdict, Words, ask
from omniscv.importing.lenses import Wide, straight
from omniscv.importing.overlap import PosedPictures, Shot

_SUFFIXES = (".json", ".txt", ".keys", ".tum", ".euroc", ".kitti", ".yaml", ".csv")
"""Of files that have poses: the others of a store are not fetched."""
_NEAR_NS = 20_000_000  # from a picture to the state of an IMU


class Written(NamedTuple):
    """Poses that a file has by the key of a frame, read by the words of its format."""

    file: Path
    poses: Mapping[str, Pose | None]
    words: Words

    @classmethod
    def of(cls, file: Path, keys: Iterable[str], entries: Iterable[Mapping[str, Any]], words: Words) -> Self:
        """Return poses that a file has, by the key of a frame.

        Args:
            file: where they are from.
            keys: of the frames, in the order of the entries.
            entries: the numbers of each pose, by the names of :meth:`Rows.of_entries`.
            words: how the format means them.
        """
        rows = Rows.of_entries([("", entry) for entry in entries])
        poses = rows.listed(frame=words.axes, inverse=words.inverse).values()
        return cls(file, dict(zip(keys, poses, strict=True)), words)


def check_pictures(folder: str, format: str | None = None) -> Iterator[tuple[str, bool]]:
    """Yield a line for each camera of the dataset and of its exports, and whether it is a fault.

    Args:
        folder: of the dataset, or its URL.
        format: of the exports; None for all that are known.

    Raises:
        ArgumentError: no dataset, no frames with colours and depth, or an unknown format.
    """
    if format is not None:
        one_of("format", format, READERS)
    frames = dataset.open(folder)
    cameras = by_camera([frame for frame in frames if {"lit", "depth"} <= frame.files.keys()])
    if not cameras:
        raise ArgumentError(f"{folder}: expected frames with lit and depth, which can be compared, got none")
    there = storage.folder(folder)
    written: dict[str, None] = {}
    for name in there.names(f"{EXPORTS}/"):
        if Path(name).suffix in _SUFFIXES:
            written[name] = None
    formats = [format] if format else list(READERS)
    with local_copy(there, written) as local:
        for name, frames_of_camera in cameras.items():
            yield from _lines_of(name, frames_of_camera, local, formats)


def _lines_of(
    camera: str, frames: Sequence[Frame], local: Path, formats: Sequence[str]
) -> Iterator[tuple[str, bool]]:
    """Yield the lines of :func:`check_pictures` of a camera, of exports in a local folder."""
    poses = {frame.key: frame.pose for frame in frames}
    exported = [Written(local / "frames.jsonl", poses, Words(along=True))]
    for out in sorted((local / EXPORTS).glob("*")):
        for kind in formats:
            exported += READERS[kind](out, frames)
    for written in exported:
        if poses.keys() & written.poses.keys():
            verdict = _verdict(frames, written)
            line = verdict.line() if verdict else "no two frames overlap"
            at = written.file.relative_to(local).as_posix()
            yield f"{at}: {camera}: {line}", bool(verdict and verdict.contradicts)


def _verdict(frames: Sequence[Frame], written: Written) -> Verdict | None:
    """Return what the pictures of frames say of poses that a file has of them; None without a pair."""
    posed: list[Frame] = []
    poses: list[Pose] = []
    for frame in frames:
        pose = written.poses.get(frame.key)
        if pose:
            posed.append(frame)
            poses.append(pose)
    camera = frames[0].camera
    panorama = camera.name == "equirectangular"
    if len(posed) < 2 or not (panorama or camera.central):
        return None
    wide = Wide(camera)

    def read(i: int, width: int) -> Shot:
        """Return the picture of the frame ``i``, of at most so many px ``width``."""
        lit = posed[i].layer("lit")
        depth = posed[i].layer("depth")
        if panorama:
            return Shot.of(depth, lit, None, width)
        depth, lens = straight(depth, wide, "depth")
        return Shot.of(depth[..., 0], straight(lit, wide, "lit")[0], lens, width)

    R = np.stack([pose.R_w_c for pose in poses])
    t = np.stack([pose.position for pose in poses])
    pictures = PosedPictures.read(R, t, read, 2.0, PAIRS, WIDTH)
    return None if pictures is None else ask(pictures, written.words)


def _nerfstudio(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    for file in (out / "transforms.json", out / frames[0].camera_name / "transforms.json"):
        if file.is_file():
            keys = []
            entries = []
            for row in json.loads(file.read_text("utf-8"))["frames"]:
                keys.append(Path(row["file_path"]).stem)
                entries.append({"transform_matrix": row["transform_matrix"]})
            yield Written.of(file, keys, entries, Words("opengl", along=True))


def _colmap(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    file = out / "sparse" / "0" / "images.txt"
    if not file.is_file():
        return
    lines = [line for line in file.read_text("utf-8").splitlines() if not line.startswith("#")]
    keys = []
    entries = []
    for line in lines[::2]:  # the others have points
        words = line.split(" ", 9)
        keys.append(Path(words[9]).stem)
        entries.append(
            dict(zip(("qw", "qx", "qy", "qz", "x", "y", "z"), map(float, words[1:8]), strict=True))
        )
    yield Written.of(file, keys, entries, Words(inverse=True, quaternions=True, along=True))


def _trajectories(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    file = out / f"{frames[0].camera_name}.keys"
    keys = file.read_text("utf-8").splitlines() if file.is_file() else []
    if not keys:
        return
    for suffix in ("tum", "euroc", "kitti"):
        path = read_trajectory(file.with_suffix(f".{suffix}"), Pose(np.zeros(3), np.eye(3)))
        poses = dict(zip(keys, path.poses, strict=True))
        yield Written(file.with_suffix(f".{suffix}"), poses, Words(quaternions=suffix != "kitti", along=True))


def _euroc(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    names = out / "mav0" / "cameras.txt"
    sensors = {}  # by camera
    if names.is_file():
        for line in names.read_text("utf-8").splitlines():
            sensor_name, camera_name = line.split(" ", 1)
            sensors[camera_name] = sensor_name
    if frames[0].camera_name not in sensors or any(frame.time_ns is None for frame in frames):
        return
    sensor = names.parent / sensors[frames[0].camera_name] / "sensor.yaml"
    T_BS = np.reshape(yaml.safe_load(sensor.read_text("utf-8"))["T_BS"]["data"], (4, 4))
    state = out / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    path = read_trajectory(state, frame=Pose(T_BS[:3, 3], T_BS[:3, :3]))
    times = np.array(path.times_ns)
    poses: dict[str, Pose | None] = {}
    for frame in frames:
        away_ns = np.abs(times - (frame.time_ns or 0))
        if away_ns.min() < _NEAR_NS:
            poses[frame.key] = path.poses[int(away_ns.argmin())]
    yield Written(state, poses, Words(along=True))


READERS: dict[str, Callable[[Path, Sequence[Frame]], Iterator[Written]]] = {
    "nerfstudio": _nerfstudio, "colmap": _colmap, "poses": _trajectories, "euroc": _euroc,
}  # fmt: skip
"""By format what reads its poses, without the code that wrote them."""
