"""Import folders of frames with poses: TartanAir V2 and TartanGround, Matterport, AirSim, OB3D.

Poses of TartanAir and AirSim are NED (x ahead, y right, z down), camera and world alike, so that with
``N`` from the camera's axes to theirs and ``M = diag(1, -1, -1)`` it is ``R_w_c = M R N``. Sources:
docs/capture-folders.md.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.sources import codecs
from omniscv.sources.base import Capture, ObjectTable, Request, View
from omniscv.sources.recording.pictures import read_picture, to_faces

_N = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
_M = np.diag([1.0, -1, -1])
_FRONT = cube_rotations()[0][1]
_FACES = {name: _FRONT.T @ R_w_c for name, R_w_c in cube_rotations()}  # from front's frame
_TARTAN = {"front": "front", "right": "right", "back": "back", "left": "left", "top": "up", "bottom": "down"}
_SAME = 2e-3  # of a rotation's entries: poses have six digits or fewer
_AIRSIM = {0: ("lit", "png"), 1: ("depth", "pfm planar"), 2: ("depth", "pfm ray"), 5: ("object_mask", "png")}


@dataclass(frozen=True)
class Sequence:
    """Pictures with poses.

    Attributes:
        layout: what was found.
        pictures: file, mode, rotation (3, 3) and position (3,) of the camera in the world, field of view in
            degrees, and encoding; without one the pixels are read, and encoded anew.
        objects: of masks.
        panoramas: whether pictures show all directions, and are resampled to six faces.
    """

    layout: str
    pictures: list[tuple[Path, str, Array, Array, float, str]]
    objects: ObjectTable = field(default_factory=lambda: ObjectTable({}))
    panoramas: bool = False

    def lines(self) -> tuple[str, ...]:
        """Return what was found, for people."""
        modes = Counter(mode for _, mode, *_ in self.pictures)
        places = len({tuple(t_w_c) for _, _, _, t_w_c, *_ in self.pictures})
        counts = ", ".join(f"{count} of {mode}" for mode, count in modes.items())
        return (f"layout {self.layout}: {places} places, {counts}",)

    def captures(self) -> Iterator[Capture]:
        """Yield the captures; ArgumentError names the picture that cannot be read."""
        for file, mode, R_w_c, t_w_c, fov_deg, encoding in self.pictures:
            with within(file.name):
                if not file.is_file():
                    raise ArgumentError("expected a picture, got no file")
                provenance = {"server": "imported", "file": file.name, "layout": self.layout}
                if encoding:
                    yield _as_received(file, mode, Pose(t_w_c, R_w_c), fov_deg, encoding, provenance)
                    continue
                picture = read_picture(file)
                one = [(picture, _FRONT, fov_deg, b"")]
                for pixels, R, face_deg, _ in to_faces(picture, mode) if self.panoramas else one:
                    pose = Pose(t_w_c, R_w_c @ _FRONT.T @ R)
                    view = View(pose, face_deg, pixels.shape[1], pixels.shape[0])
                    yield Capture(Request(view, mode), view, pixels, provenance, *codecs.encode(pixels))


def _as_received(
    file: Path, mode: str, pose: Pose, fov_deg: float, encoding: str, provenance: dict[str, Any]
) -> Capture:
    payload = file.read_bytes()
    try:
        view = View(pose, fov_deg, *_size(payload))
        pixels = codecs.decode(payload, encoding, mode, view)
    except BadReplyError as cause:
        raise ArgumentError(str(cause)) from cause
    return Capture(Request(view, mode), view, pixels, provenance, payload, encoding)


def find_sequence(folder: Path) -> Sequence | None:
    """Return the frames of a folder by what lies in it; None where it is none of these layouts.

    Raises:
        ArgumentError: files of a layout without poses, or poses that contradict each other.
    """
    found = next((each for each in _LAYOUTS if all((folder / mark).exists() for mark in each[1])), None)
    if found is None:
        return None
    layout, _, read = found
    try:
        return read(folder)
    except ArgumentError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, OSError) as cause:
        got = f"{type(cause).__name__} {shown(str(cause))}"
        raise ArgumentError(f"expected a folder of layout {layout}, got {got}") from cause


def _tartanair(folder: Path) -> Sequence:
    pictures = []
    for side in ("lcam", "rcam"):
        if not (folder / f"image_{side}_front").is_dir():
            continue
        front = _ned_poses(folder / f"pose_{side}_front.txt")
        for word, name in _TARTAN.items():
            camera = f"{side}_{word}"
            R_w_c = front[0] @ _FACES[name]  # exact: the poses of the other faces have six digits
            _check_turned(folder / f"pose_{camera}.txt", R_w_c, name)
            kinds = ("image", "", "lit", "png"), ("depth", "_depth", "depth", "png float32")
            for kind, ending, mode, encoding in (*kinds, ("seg", "_seg", "object_mask", "png ids")):
                for file in sorted((folder / f"{kind}_{camera}").glob(f"*_{camera}{ending}.png")):
                    i = int(file.name.split("_")[0])
                    if i >= len(R_w_c):
                        raise ArgumentError(f"{file.name}: expected one of {len(R_w_c)} poses of {camera}")
                    pictures.append((file, mode, R_w_c[i], front[1][i], 90.0, encoding))
    return Sequence("tartanair", pictures, _classes(folder))


def _ned_poses(file: Path) -> tuple[Array, Array]:
    """(N, 3, 3) R_w_c and (N, 3) positions of lines ``x y z qx qy qz qw``."""
    with within(file.name):
        if not file.exists():
            raise ArgumentError("expected a file of poses, got none")
        try:
            rows = np.loadtxt(file, ndmin=2)
            turns = Rotation.from_quat(rows[:, 3:7]).as_matrix()
        except (ValueError, IndexError) as cause:
            raise ArgumentError(f"expected lines x y z qx qy qz qw, got: {cause}") from cause
        return _M @ turns @ _N, rows[:, :3] @ _M


def _check_turned(file: Path, due: Array, name: str) -> None:
    R_w_c, _ = _ned_poses(file)
    off = np.abs(R_w_c - due[: len(R_w_c)]).max(axis=(1, 2)) if len(R_w_c) == len(due) else np.ones(1)
    if off.max() > _SAME:
        line = int(off.argmax())
        angle = np.degrees(Rotation.from_matrix(R_w_c[line].T @ due[line]).magnitude())
        raise ArgumentError(
            f"{file.name} line {line + 1}: expected the front's turned {name}, off by {angle:.3g} degrees"
        )


def _classes(folder: Path) -> ObjectTable:
    """The classes of masks as objects: ``name_map`` of seg_label_map.json, here or beside the sequences."""
    for place in (folder, *folder.absolute().parents[:2]):
        if (place / "seg_label_map.json").exists():
            ids = json.loads((place / "seg_label_map.json").read_text()).get("name_map", {})
            return ObjectTable({}, 0, {str(name): int(i) for name, i in ids.items()})
    return ObjectTable({})


def _matterport(folder: Path) -> Sequence:
    conf = sorted((folder / "undistorted_camera_parameters").glob("*.conf"))
    if not conf:
        raise ArgumentError("expected undistorted_camera_parameters/*.conf with the poses, got none")
    scans = re.findall(r"^scan \S+ (\S+)_i1_5\.jpg ((?:\S+ ?){16})$", conf[0].read_text(), re.MULTILINE)
    poses = {place: np.array(values.split(), float).reshape(4, 4) for place, values in scans}
    pictures = []
    for file in sorted((folder / "matterport_skybox_images").glob("*_skybox?_sami.jpg")):
        place, face = file.name.split("_skybox")
        if place not in poses:
            raise ArgumentError(f"{file.name}: expected its pose, of image i1_5, in {conf[0].name}")
        name = ("up", "front", "right", "back", "left", "down")[int(face[0])]
        pose = poses[place]
        R_w_c = _orthonormal(pose[:3, :3] @ _M) @ _FACES[name]
        pictures.append((file, "lit", R_w_c, pose[:3, 3], 90.0, ""))
    return Sequence("matterport", pictures)


def _ob3d(folder: Path) -> Sequence:
    pictures = []
    for file in sorted((folder / "cameras").glob("*_cam.json")):
        number = file.name.removesuffix("_cam.json")
        with within(file.name):
            outer = json.loads(file.read_text())[0]["extrinsics"]
            R_c_w = _orthonormal(np.array(outer["rotation"], float))
            t_w_c = -R_c_w.T @ np.array(outer["translation"], float)
        for kind, ending, mode in (("images", "rgb.png", "lit"), ("depths", "depth.exr", "depth")):
            picture = folder / kind / f"{number}_{ending}"
            if picture.exists():
                pictures.append((picture, mode, R_c_w.T, t_w_c, 360.0, ""))
    return Sequence("ob3d", pictures, panoramas=True)


def _airsim(folder: Path) -> Sequence:
    if not (folder / "settings.json").exists():
        raise ArgumentError("expected settings.json: the poses of airsim_rec.txt are the vehicle's")
    settings = json.loads((folder / "settings.json").read_text())
    pictures = []
    lines = (folder / "airsim_rec.txt").read_text().splitlines()
    for line in lines[1:]:
        row = dict(zip(lines[0].split("\t"), line.split("\t"), strict=False))
        t_v = np.array([float(row[f"POS_{axis}"]) for axis in "XYZ"])
        R_v = Rotation.from_quat([float(row[f"Q_{axis}"]) for axis in "XYZW"]).as_matrix()
        for name in row["ImageFile"].split(";"):
            match = re.fullmatch(rf"img_{re.escape(row['VehicleName'])}_(.*)_(\d)_\d+\.\w+", name)
            if match is None or int(match[2]) not in _AIRSIM:
                raise ArgumentError(f"airsim_rec.txt: expected img_VEHICLE_CAMERA_TYPE_NS, got {shown(name)}")
            vehicle = settings.get("Vehicles", {}).get(row["VehicleName"], {})
            camera: dict[str, Any] = vehicle.get("Cameras", {}).get(match[1])
            if camera is None:
                raise ArgumentError(f"settings.json: expected the camera {shown(match[1])} of its vehicle")
            angles = [camera.get(axis, 0.0) for axis in ("Yaw", "Pitch", "Roll")]
            R_c = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
            offset = R_v @ [camera.get(axis, 0.0) for axis in "XYZ"]
            mode, encoding = _AIRSIM[int(match[2])]
            of_type = {each["ImageType"]: each for each in camera.get("CaptureSettings", [])}
            fov_deg = float(of_type.get(int(match[2]), {}).get("FOV_Degrees", 90))
            R_w_c, t_w_c = _orthonormal(_M @ R_v @ R_c @ _N), _M @ (t_v + offset)
            pictures.append((folder / "images" / name, mode, R_w_c, t_w_c, fov_deg, encoding))
    return Sequence("airsim", pictures)


def _orthonormal(R: Array) -> Array:
    """The nearest rotation: files have six digits."""
    return np.asarray(Rotation.from_matrix(R).as_matrix())


def _size(payload: bytes) -> tuple[int, int]:
    if header := re.match(rb"Pf\s+(\d{1,5})\s+(\d{1,5})\s", payload):
        return int(header[1]), int(header[2])
    return codecs.picture_size(payload)


_LAYOUTS: tuple[tuple[str, tuple[str, ...], Callable[[Path], Sequence]], ...] = (
    ("airsim", ("airsim_rec.txt",), _airsim),
    ("ob3d", ("cameras", "images"), _ob3d),
    ("tartanair", ("image_lcam_front",), _tartanair),
    ("tartanair", ("image_rcam_front",), _tartanair),
    ("matterport", ("matterport_skybox_images",), _matterport),
)
"""Layouts, what lies in their folders, and their readers."""
