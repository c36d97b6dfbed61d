"""Ask a dataset's pictures whether the poses of its exports are in the convention that their formats have."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from omniscv import dataset, storage
from omniscv.arguments import one_of
from omniscv.dataset.exporting import EXPORTS
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.geometry.trajectory_columns import axes_of
from omniscv.sources.recording.conventions import PAIRS, WIDTH, Verdict, Words, ask
from omniscv.sources.recording.lenses import Wide
from omniscv.sources.recording.overlap import PosedPictures, Shot

_NEAR_NS = 20_000_000  # from a picture to the state of an IMU


class Written(NamedTuple):
    """Poses in a file: 4 x 4 matrices of its numbers by the key of a frame, and what its format says."""

    file: str
    matrices: dict[str, Array]
    words: Words


def check_pictures(folder: str, format: str | None = None) -> Iterator[tuple[str, bool]]:
    """Yield a line for each camera of the dataset and of its exports, and whether it is a fault.

    Raises:
        ArgumentError: no dataset, a dataset by URL, no frames with colours and depth, or an unknown format.
    """
    if (local := storage.folder(folder).local) is None:
        raise ArgumentError(f"{folder}: expected a dataset in a folder, got a URL")
    if format is not None:
        one_of("format", format, READERS)
    frames = dataset.open(folder)
    cameras = by_camera([frame for frame in frames if {"lit", "depth"} <= frame.files.keys()])
    if not cameras:
        raise ArgumentError(f"{folder}: expected frames with lit and depth, which can be compared, got none")
    for name, mine in cameras.items():
        own = Written("frames.jsonl", {frame.key: _matrix(frame) for frame in mine}, Words(along=True))
        exported = [own]
        for out in sorted((local / EXPORTS).glob("*")):
            for kind in [format] if format else READERS:
                exported += READERS[kind](out, mine)
        keys = {frame.key for frame in mine}
        for written in (each for each in exported if keys & each.matrices.keys()):
            verdict = _verdict(mine, written)
            at = written.file if written is own else f"{EXPORTS}/{written.file}"
            is_right = verdict is None or not verdict.contradicts
            yield f"{at}: {name}: {verdict.line() if verdict else 'no two frames overlap'}", not is_right


def _matrix(frame: Frame) -> Array:
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([frame.pose.R_w_c, frame.pose.position])
    return matrix


def _verdict(frames: Sequence[Frame], written: Written) -> Verdict | None:
    """Return what the pictures of frames say of poses that a file has of them; None without a pair."""
    mine = [frame for frame in frames if frame.key in written.matrices]
    camera = frames[0].camera
    panorama = camera.name == "equirectangular"
    if len(mine) < 2 or not (panorama or camera.central):
        return None
    matrices = np.stack([written.matrices[frame.key] for frame in mine])
    placed = np.linalg.inv(matrices) if written.words.inverse else matrices
    R, t = placed[:, :3, :3] @ axes_of(written.words.axes)[1], np.asarray(placed[:, :3, 3], np.float64)
    wide = Wide(camera)

    def read(i: int, width: int) -> Shot:
        lit, depth = mine[i].layer("lit"), mine[i].layer("depth")
        if panorama:
            return Shot.of(depth, lit, None, width)
        depth, lens = wide.straight(depth, False)
        return Shot.of(depth, wide.straight(lit, True)[0], lens, width)

    pictures = PosedPictures.read(R, t, read, 2.0, PAIRS, WIDTH)
    return None if pictures is None else ask(pictures, written.words)


def _nerfstudio(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    for file in (out / "transforms.json", out / frames[0].camera_name / "transforms.json"):
        if file.is_file():
            entries = json.loads(file.read_text("utf-8"))["frames"]
            poses = {Path(entry["file_path"]).stem: np.array(entry["transform_matrix"]) for entry in entries}
            yield Written(_name(out, file), poses, Words("opengl", along=True))


def _colmap(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    file = out / "sparse" / "0" / "images.txt"
    if file.is_file():
        lines = [line for line in file.read_text("utf-8").splitlines() if not line.startswith("#")]
        poses = {}
        for line in lines[::2]:
            _, *numbers, _, name = line.split(" ", 9)
            w, x, y, z, *t = map(float, numbers)
            poses[Path(name).stem] = _posed(t, (x, y, z, w))
        yield Written(_name(out, file), poses, Words(inverse=True, quaternions=True, along=True))


def _trajectories(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    keys = out / f"{frames[0].camera_name}.keys"
    for suffix in ("tum", "euroc", "kitti") if keys.is_file() else ():
        file = keys.with_suffix(f".{suffix}")
        rows = np.loadtxt(file, comments="#", delimiter="," if suffix == "euroc" else None, ndmin=2)
        if suffix == "kitti":
            matrices = [np.vstack([row.reshape(3, 4), [0, 0, 0, 1]]) for row in rows]
        else:
            order = [4, 5, 6, 7] if suffix == "tum" else [5, 6, 7, 4]
            matrices = [_posed(row[1:4], row[order]) for row in rows]
        poses = dict(zip(keys.read_text("utf-8").split("\n"), matrices, strict=False))
        yield Written(_name(out, file), poses, Words(quaternions=suffix != "kitti", along=True))


def _euroc(out: Path, frames: Sequence[Frame]) -> Iterator[Written]:
    names = out / "mav0" / "cameras.txt"
    if not names.is_file() or any(frame.time_ns is None for frame in frames):
        return
    sensors = [line.split(" ", 1) for line in names.read_text("utf-8").splitlines()]
    if (cam := next((cam for cam, name in sensors if name == frames[0].camera_name), "")) == "":
        return
    state = out / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    T_BS = np.reshape(
        yaml.safe_load((names.parent / cam / "sensor.yaml").read_text("utf-8"))["T_BS"]["data"], (4, 4)
    )
    rows = np.loadtxt(state, comments="#", delimiter=",", ndmin=2, usecols=range(1, 8))
    times = np.loadtxt(state, comments="#", delimiter=",", ndmin=1, usecols=0, dtype=np.int64)
    poses = {}
    for frame in frames:
        i = int(np.abs(times - (frame.time_ns or 0)).argmin())
        if abs(int(times[i]) - (frame.time_ns or 0)) < _NEAR_NS:
            poses[frame.key] = _posed(rows[i, :3], rows[i, [4, 5, 6, 3]]) @ T_BS
    yield Written(_name(out, state), poses, Words(along=True))


def _posed(position: Iterable[float], quaternion: Iterable[float]) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat([*quaternion]).as_matrix(), [*position]
    return matrix


def _name(out: Path, file: Path) -> str:
    return file.relative_to(out.parent).as_posix()


READERS: dict[str, Callable[[Path, Sequence[Frame]], Iterator[Written]]] = {
    "nerfstudio": _nerfstudio, "colmap": _colmap, "poses": _trajectories, "euroc": _euroc,
}  # fmt: skip
"""By format what reads its poses, without the code that wrote them."""
