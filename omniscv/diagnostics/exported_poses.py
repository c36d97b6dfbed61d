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
        """Return poses of entries, by what :meth:`Rows.of_entries` calls their numbers."""
        rows = Rows.of_entries([("", entry) for entry in entries])
        poses = rows.listed(frame=words.axes, inverse=words.inverse).values()
        return cls(file, dict(zip(keys, poses, strict=True)), words)


def check_pictures(folder: str, format: str | None = None) -> Iterator[tuple[str, bool]]:
    """Yield a line for each camera of the dataset and of its exports, and whether it is a fault.

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
    written = [name for name in there.names(f"{EXPORTS}/") if Path(name).suffix in _SUFFIXES]
    with local_copy(there, dict.fromkeys(written)) as local:
        for name, mine in cameras.items():
            yield from _lines_of(name, mine, local, [format] if format else list(READERS))


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
    posed = [(frame, pose) for frame in frames if (pose := written.poses.get(frame.key))]
    camera = frames[0].camera
    panorama = camera.name == "equirectangular"
    if len(posed) < 2 or not (panorama or camera.central):
        return None
    wide = Wide(camera)

    def read(i: int, width: int) -> Shot:
        lit, depth = (posed[i][0].layer(mode) for mode in ("lit", "depth"))
        if panorama:
            return Shot.of(depth, lit, None, width)
        depth, lens = straight(depth, wide, "depth")
        return Shot.of(depth[..., 0], straight(lit, wide, "lit")[0], lens, width)

    R, t = (np.stack([getattr(pose, key) for _, pose in posed]) for key in ("R_w_c", "position"))
    pictures = PosedPictures.read(R, t, read, 2.0, PAIRS, WIDTH)
    return None if pictures is None else ask(pictures, written.words)


def _nerfstudio(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    for file in (out / "transforms.json", out / frames[0].camera_name / "transforms.json"):
        if file.is_file():
            rows = json.loads(file.read_text("utf-8"))["frames"]
            keys = [Path(row["file_path"]).stem for row in rows]
            matrix = "transform_matrix"
            yield Written.of(file, keys, [{matrix: row[matrix]} for row in rows], Words("opengl", along=True))


def _colmap(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    file = out / "sparse" / "0" / "images.txt"
    if file.is_file():
        lines = [line for line in file.read_text("utf-8").splitlines() if not line.startswith("#")]
        rows = [line.split(" ", 9) for line in lines[::2]]
        names = ("qw", "qx", "qy", "qz", "x", "y", "z")
        poses = [dict(zip(names, map(float, row[1:8]), strict=True)) for row in rows]
        words = Words(inverse=True, quaternions=True, along=True)
        yield Written.of(file, [Path(row[9]).stem for row in rows], poses, words)


def _trajectories(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    file = out / f"{frames[0].camera_name}.keys"
    keys = file.read_text("utf-8").splitlines() if file.is_file() else []
    for suffix in ("tum", "euroc", "kitti") if keys else ():
        path = read_trajectory(file.with_suffix(f".{suffix}"), Pose(np.zeros(3), np.eye(3)))
        poses = dict(zip(keys, path.poses, strict=True))
        yield Written(file.with_suffix(f".{suffix}"), poses, Words(quaternions=suffix != "kitti", along=True))


def _euroc(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    names = out / "mav0" / "cameras.txt"
    lines = names.read_text("utf-8").splitlines() if names.is_file() else []
    sensors = dict(line.split(" ", 1)[::-1] for line in lines)
    if frames[0].camera_name not in sensors or any(frame.time_ns is None for frame in frames):
        return
    sensor = names.parent / sensors[frames[0].camera_name] / "sensor.yaml"
    T_BS = np.reshape(yaml.safe_load(sensor.read_text("utf-8"))["T_BS"]["data"], (4, 4))
    state = out / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    path = read_trajectory(state, frame=Pose(T_BS[:3, 3], T_BS[:3, :3]))
    times = np.array(path.times_ns)
    poses = dict[str, Pose | None]()
    for frame in frames:
        off = np.abs(times - (frame.time_ns or 0))
        if off.min() < _NEAR_NS:
            poses[frame.key] = path.poses[int(off.argmin())]
    yield Written(state, poses, Words(along=True))


READERS: dict[str, Callable[[Path, Sequence[Frame]], Iterator[Written]]] = {
    "nerfstudio": _nerfstudio, "colmap": _colmap, "poses": _trajectories, "euroc": _euroc,
}  # fmt: skip
"""By format what reads its poses, without the code that wrote them."""
