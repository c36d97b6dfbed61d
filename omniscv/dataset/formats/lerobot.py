"""LeRobotDataset v3.0, as its documents have it; the extra ``lerobot`` writes it.

Each episode has a file of rows, ``data/chunk-000/file-000.parquet``, and a video a camera,
``videos/observation.images.NAME/chunk-000/file-000.mp4``. Depth and labels are columns of images, without
loss: depth 16 bits of millimetres along the ray, 0 without a surface or beyond 65.5 m; labels instance ids.
Rows hold the state and the action that the frames have, else the pose of the rig; and the pose of each
camera. ``meta/info.json`` has each lens, as :meth:`omniscv.cameras.Camera.to_dict` describes it, and so has
``calibration/NAME.json``.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omniscv.arguments import optional_number
from omniscv.cameras import Camera
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.manifest import any_text
from omniscv.dataset.media import BT601, encoded_video
from omniscv.dataset.sequences import Moment, rigs, timed
from omniscv.dataset.stepping import EPISODE
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import NS
from omniscv.records import checked, record
from omniscv.storage.local import write_bytes

VERSION = "v3.0"
POSE_NAMES = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""A pose in rows: metres and a unit quaternion, from the camera or the rig to the world."""
_FILES_OF_A_CHUNK = 1000
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA = f"data/{_FILE}.parquet"
_VIDEO = f"videos/{{video_key}}/{_FILE}.mp4"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"
_MILLIMETRES = 1000
_FARTHEST_MM = 65535
_TIME_TOLERANCE_S = 1e-4
"""How far a frame may be off the even steps of a video: what readers of the format allow."""
_GROUP = 2
"""Frames of a video from one that is coded alone to the next: readers take single ones."""
_SAMPLED = 500
"""Frames, evenly spread, of which the statistics of pictures are taken."""
_QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
_COUNTED: dict[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns of single numbers that every dataset of the format has."""


@record
class LerobotOptions:
    """Options of the format."""

    fps: float | None = checked(
        optional_number,
        above=0,
        default=None,
        help="frames a second; those of the frames' times if not given",
    )
    task: str = checked(any_text, default="", help="what is done, of frames that do not say it")


class Episode(NamedTuple):
    """Frames that follow each other.

    Attributes:
        moments: of each step, the frames by camera, and the rig's pose in the world.
        task: what is done.
    """

    moments: list[tuple[Moment, Pose]]
    task: str


@register
class Lerobot(Format):
    """See the module."""

    name = "lerobot"
    needs = ("lit",)
    options = LerobotOptions

    def refuses(self, camera: Camera) -> str | None:
        """Refuse pictures that H.264 cannot hold."""
        if camera.width % 2 or camera.height % 2:
            return f"expected an even width and height, as H.264 needs, got {camera.width} x {camera.height}"
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: LerobotOptions) -> list[Path]:
        """Write ``frames`` below ``out``, an episode after the other; return the files of ``meta/``."""
        _pyarrow()
        if not frames:
            raise ArgumentError("expected frames, got none")
        episodes = episodes_of(frames, options.task)
        fps = _rate(episodes, options.fps)
        tasks = sorted({episode.task for episode in episodes})
        writer = _Writer(out, fps, tasks, episodes)
        for number_of_episode, episode in enumerate(episodes):
            writer.write_episode(number_of_episode, episode)
        return writer.write_meta()


def episodes_of(frames: Sequence[Frame], task: str = "") -> list[Episode]:
    """Return the episodes of frames: those that they say, else one of each world.

    Args:
        frames: of a dataset.
        task: what is done in those that do not say it.

    Raises:
        ArgumentError: the cameras of an episode are not all there at each step.
    """
    by_episode: dict[tuple[str, int], list[Frame]] = {}
    for frame in frames:
        said = frame.truth.get(EPISODE, {})
        by_episode.setdefault((frame.world, int(said.get("index", 0))), []).append(frame)
    names = sorted({frame.camera_name for frame in frames})
    episodes = []
    for (world, index), of_episode in sorted(by_episode.items()):
        moments = _moments(of_episode)
        for moment, _ in moments:
            if sorted(moment) != names:
                where = f"episode {index} {world}".strip()
                expected = f"expected a frame of each of {', '.join(names)} at every step"
                raise ArgumentError(
                    f"{where}: {expected}, got {', '.join(sorted(moment))} alone; choose cameras"
                )
        said = of_episode[0].truth.get(EPISODE, {})
        episodes.append(Episode(moments, str(said.get("task", task))))
    return episodes


def _moments(frames: Sequence[Frame]) -> list[tuple[Moment, Pose]]:
    """Return the frames of each step in their order, and the pose of the rig, that of the first camera."""
    steps: dict[object, Moment] = {}
    for rig in rigs(frames):
        for moment, _ in rig.moments:
            first = next(iter(moment.values()))
            step = first.truth.get(EPISODE, {}).get("step", first.time_ns)
            key = first.key.removeprefix(first.camera_name) if step is None else step
            steps.setdefault(key, {}).update(moment)
    moments = []
    for key in sorted(steps, key=lambda step: (str(type(step)), step)):
        moment = dict(sorted(steps[key].items()))
        moments.append((moment, next(iter(moment.values())).pose))
    return moments


def _rate(episodes: Sequence[Episode], given: float | None) -> float:
    """Return the frames a second; ArgumentError for frames that are not evenly spaced, or have no times."""
    times = []
    for episode in episodes:
        first = [next(iter(moment.values())) for moment, _ in episode.moments]
        if timed(first):
            times.append(np.array([frame.time_ns for frame in first], np.int64))
    if not times:
        if given is None:
            raise ArgumentError("expected frames with times, or fps, got neither; give fps")
        return given
    steps = np.concatenate([np.diff(of_episode) for of_episode in times]) / NS
    rate = given
    if rate is None:
        if not len(steps):
            raise ArgumentError("expected episodes of two frames or more, or fps; give fps")
        rate = 1 / float(np.median(steps))
        rate = round(rate) if abs(rate - round(rate)) < 1e-3 * rate else rate
    for of_episode in times:
        off = np.abs((of_episode - of_episode[0]) / NS - np.arange(len(of_episode)) / rate)
        if off.max() > _TIME_TOLERANCE_S:
            expected = f"expected frames every {1 / rate:.6g} s within {_TIME_TOLERANCE_S:g} s"
            raise ArgumentError(f"{expected}, got one that is {off.max():.3g} s off; export an even part")
    return rate


class _Writer:
    """Writes the files of a dataset of episodes.

    Args:
        out: the folder.
        fps: frames a second.
        tasks: of all episodes, in their order.
        episodes: all of them.
    """

    def __init__(self, out: Path, fps: float, tasks: Sequence[str], episodes: Sequence[Episode]) -> None:
        self._out = out
        self._fps = fps
        self._tasks = list(tasks)
        self._rows: list[dict[str, Any]] = []  # of meta/episodes
        self._frame_count = sum(len(episode.moments) for episode in episodes)
        self._every = -(-self._frame_count // _SAMPLED)
        self._values: dict[str, list[NDArray[Any]]] = {}  # of statistics, by column
        first, _ = episodes[0].moments[0]
        self._cameras = {name: frame.camera for name, frame in first.items()}
        self._features = self._described(first)
        self._written = 0

    def write_episode(self, index: int, episode: Episode) -> None:
        """Write the rows and the videos of an episode."""
        from pyarrow import parquet

        place = {"chunk_index": index // _FILES_OF_A_CHUNK, "file_index": index % _FILES_OF_A_CHUNK}
        length = len(episode.moments)
        seconds = np.arange(length) / self._fps
        counted = {
            "timestamp": seconds,
            "frame_index": np.arange(length),
            "episode_index": np.full(length, index),
            "index": self._written + np.arange(length),
            "task_index": np.full(length, self._tasks.index(episode.task)),
        }
        row: dict[str, Any] = {
            "episode_index": index,
            "tasks": [episode.task],
            "length": length,
            "dataset_from_index": self._written,
            "dataset_to_index": self._written + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        data = self._out / _DATA.format(**place)
        data.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(self._table(episode, counted), data)
        row |= {f"data/{name}": value for name, value in place.items()}
        for name in self._cameras:
            key = _picture(name)
            path = self._out / _VIDEO.format(video_key=key, **place)
            path.parent.mkdir(parents=True, exist_ok=True)
            of_camera = [moment[name] for moment, _ in episode.moments]
            path.write_bytes(encoded_video(of_camera, self._fps, group=_GROUP, matrix=BT601))
            row |= {f"videos/{key}/{part}": value for part, value in place.items()}
            row[f"videos/{key}/from_timestamp"] = 0.0
            row[f"videos/{key}/to_timestamp"] = length / self._fps
        self._rows.append(row)
        self._written += length

    def write_meta(self) -> list[Path]:
        """Write what describes the episodes, and return its files."""
        import pyarrow
        from pyarrow import parquet

        episodes = self._out / _EPISODES
        episodes.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pyarrow.Table.from_pylist(self._rows), episodes)
        tasks = self._out / "meta/tasks.parquet"
        parquet.write_table(_indexed_by_task(self._tasks), tasks)
        paths = [episodes, tasks, self._out / "meta/stats.json", self._out / "meta/info.json"]
        _write_json(paths[2], self._statistics())
        for name, camera in self._cameras.items():
            calibration = self._out / f"calibration/{name}.json"
            calibration.parent.mkdir(exist_ok=True)
            _write_json(calibration, camera.to_dict())
            paths.append(calibration)
        _write_json(paths[3], self._info())
        return paths

    def _info(self) -> dict[str, Any]:
        """Return what ``meta/info.json`` has."""
        whole = self._fps == round(self._fps)
        return {
            "codebase_version": VERSION,
            "robot_type": None,
            "total_episodes": len(self._rows),
            "total_frames": self._written,
            "total_tasks": len(self._tasks),
            "chunks_size": _FILES_OF_A_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": round(self._fps) if whole else self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": _DATA,
            "video_path": _VIDEO,
            "features": self._features,
        }

    def _described(self, first: Moment) -> dict[str, Any]:
        """Return the features: each column and video with its form, and lenses with theirs."""
        features: dict[str, Any] = {}
        for name, frame in first.items():
            features[_picture(name)] = self._lens(frame)
            for kind in ("depth", "labels"):
                if kind in frame.files:
                    features[_picture(name, kind)] = self._flat_picture(frame, kind)
        for key, value, names in _vectors(first, next(iter(first.values())).pose):
            features[key] = {"dtype": value.dtype.name, "shape": [len(value)], "names": names}
        for key, dtype in _COUNTED.items():
            features[key] = {"dtype": dtype, "shape": [1], "names": None}
        return features

    def _lens(self, frame: Frame) -> dict[str, Any]:
        """Return the feature of a camera's video."""
        height, width = frame.camera.height, frame.camera.width
        info = {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": self._fps,
            "video.channels": 3,
            "has_audio": False,
            "camera": frame.camera.to_dict(),
            "pose": f"observation.pose.{frame.camera_name}",
        }
        return {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": info,
        }

    def _flat_picture(self, frame: Frame, kind: str) -> dict[str, Any]:
        """Return the feature of a column of pictures of one channel: depth or labels."""
        info: dict[str, Any] = {"is_depth_map": kind == "depth"}
        if kind == "depth":
            info |= {"depth_unit": "mm", "depth_kind": "along the ray", "none": 0}
        else:
            info["instances"] = dict(frame.instances)
        shape = [frame.camera.height, frame.camera.width, 1]
        return {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"], "info": info}

    def _table(self, episode: Episode, counted: Mapping[str, NDArray[Any]]) -> Any:
        """Return the rows of an episode, in the order of the features."""
        import pyarrow

        columns: dict[str, Any] = {}
        for key, dtype in _COUNTED.items():
            columns[key] = pyarrow.array(counted[key].astype(dtype))
            self._values.setdefault(key, []).append(counted[key].astype(dtype))
        vectors: dict[str, list[NDArray[Any]]] = {}
        pictures: dict[str, list[dict[str, Any]]] = {}
        for number_of_row, (moment, pose) in enumerate(episode.moments):
            for key, value, _ in _vectors(moment, pose):
                self._check_form(key, value)
                vectors.setdefault(key, []).append(value)
            is_sampled = (self._written + number_of_row) % self._every == 0
            for name, frame in moment.items():
                self._add_pictures(pictures, name, frame, is_sampled)
        for key, rows in vectors.items():
            stacked = np.stack(rows)
            self._values.setdefault(key, []).append(stacked)
            columns[key] = pyarrow.array(stacked.ravel())
            if stacked.shape[1] > 1:  # vectors of one number are numbers in the format
                columns[key] = pyarrow.FixedSizeListArray.from_arrays(columns[key], stacked.shape[1])
        form = pyarrow.struct([("bytes", pyarrow.binary()), ("path", pyarrow.string())])
        for key, encoded in pictures.items():
            columns[key] = pyarrow.array(encoded, form)
        return pyarrow.table({key: columns[key] for key in self._features if key in columns})

    def _check_form(self, key: str, value: NDArray[Any]) -> None:
        """Refuse a state or an action of another form than the first frame's."""
        feature = self._features.get(key)
        if feature is None or feature["shape"] != [len(value)] or feature["dtype"] != value.dtype.name:
            form = "none" if feature is None else f"{feature['dtype']} of {feature['shape'][0]} numbers"
            raise ArgumentError(
                f"{key}: expected {form}, as the first frame has, got {value.dtype} of {len(value)}"
            )

    def _add_pictures(
        self, pictures: dict[str, list[dict[str, Any]]], name: str, frame: Frame, is_sampled: bool
    ) -> None:
        """Add the encoded depth and labels of a frame to columns, and samples of all to the statistics."""
        if is_sampled:
            colors = uint8_colors(frame.layer("lit"))
            self._values.setdefault(_picture(name), []).append(_thinned(colors).reshape(-1, 3) / 255)
        for kind, encode in (("depth", millimetres), ("labels", np.asarray)):
            key = _picture(name, kind)
            if key not in self._features:
                continue
            values = encode(frame.layer(kind)).astype(np.uint16)
            pictures.setdefault(key, []).append({"bytes": _png(values), "path": f"{frame.key}.{kind}.png"})
            if is_sampled and kind == "depth":
                sample = _thinned(values).reshape(-1, 1).astype(np.float64)
                self._values.setdefault(key, []).append(sample)

    def _statistics(self) -> dict[str, Any]:
        """Return minimum, maximum, mean, standard deviation and quantiles of each column; of pictures by
        channel, of a sample."""
        statistics = {}
        for key, parts in self._values.items():
            values = np.concatenate([part.reshape(len(part), -1) for part in parts]).astype(np.float64)
            shape = (-1, 1, 1) if self._features[key]["dtype"] in ("video", "image") else (-1,)
            found = {
                "min": values.min(axis=0),
                "max": values.max(axis=0),
                "mean": values.mean(axis=0),
                "std": values.std(axis=0),
            }
            for share in _QUANTILES:
                found[f"q{round(100 * share):02d}"] = np.quantile(values, share, axis=0)
            by_name = {name: value.reshape(shape).tolist() for name, value in found.items()}
            statistics[key] = {**by_name, "count": [len(values)]}
        return statistics


def millimetres(depth: NDArray[Any]) -> NDArray[np.uint16]:
    """Return depth (H, W), metres along the ray, in whole millimetres.

    0 stands for no surface, and for one beyond 65.5 m.
    """
    rounded = np.rint(_MILLIMETRES * np.nan_to_num(depth.astype(np.float64), posinf=0, neginf=0))
    return np.where(rounded > _FARTHEST_MM, 0, rounded).astype(np.uint16)


def _vectors(moment: Moment, rig_pose: Pose) -> list[tuple[str, NDArray[Any], list[str] | None]]:
    """Return the vectors of a step: their column, value and the names of their numbers."""
    said = next(iter(moment.values())).truth.get(EPISODE, {})
    rig = _numbers_of(rig_pose)
    vectors: list[tuple[str, NDArray[Any], list[str] | None]] = []
    if "state" in said:
        vectors.append(("observation.state", _vector(said, "state"), None))
    else:
        vectors.append(("observation.state", rig, list(POSE_NAMES)))
    if "action" in said:
        vectors.append(("action", _vector(said, "action"), None))
    for name, frame in moment.items():
        vectors.append((f"observation.pose.{name}", _numbers_of(frame.pose), list(POSE_NAMES)))
    return vectors


def _vector(said: Mapping[str, Any], key: str) -> NDArray[Any]:
    """Return a state or an action of an episode's record, in the type that it was given in."""
    return np.asarray(said[key], said.get(f"{key}_dtype", "float64"))


def _numbers_of(pose: Pose) -> Array:
    """Return (7,) position and quaternion, of which w is not negative."""
    quaternion = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
    return np.concatenate([pose.position, quaternion])


def _picture(name: str, kind: str = "") -> str:
    """Return the column of a camera's pictures: of colours, ``depth`` or ``labels``."""
    return f"observation.images.{name}" + (f"_{kind}" if kind else "")


def _png(values: NDArray[np.uint16]) -> bytes:
    encoded = cv2.imencode(".png", values)[1]
    return bytes(encoded.tobytes())


def _thinned(values: NDArray[Any]) -> NDArray[Any]:
    """Return a sample of a picture's pixels: of large ones, every few rows and columns."""
    step = max(1, max(values.shape[:2]) // 150)
    return values[::step, ::step]


def _indexed_by_task(tasks: Sequence[str]) -> Any:
    """Return the table of tasks, in which pandas finds the number of a task by its text."""
    import pyarrow

    index = "__index_level_0__"
    table = pyarrow.table({"task_index": np.arange(len(tasks)), index: list(tasks)})
    text_column = {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object"}
    number_column = {
        "name": "task_index",
        "field_name": "task_index",
        "pandas_type": "int64",
        "numpy_type": "int64",
    }
    described = {"index_columns": [index], "column_indexes": [], "columns": [number_column, text_column]}
    return table.replace_schema_metadata({"pandas": json.dumps(described)})


def _write_json(path: Path, content: Any) -> None:
    write_bytes(path, json.dumps(content, indent=2, sort_keys=False).encode())


def _pyarrow() -> None:
    """Raise ArgumentError where the packages of the extra are missing."""
    try:
        import av
        import pyarrow
    except ImportError as missing:
        raise ArgumentError(f"expected {missing.name}, got none; install omniscv[lerobot]") from None
    del av, pyarrow
