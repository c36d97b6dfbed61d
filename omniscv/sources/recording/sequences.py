"""Import folders of frames with poses: TartanAir V2 and TartanGround, OB3D.

Poses of TartanAir are NED (x ahead, y right, z down), camera and world alike, so that with
``N`` from the camera's axes to theirs and ``M = diag(1, -1, -1)`` it is ``R_w_c = M R N``. Sources:
docs/capture-folders.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.sources import codecs
from omniscv.sources.base import Capture, ObjectTable, Request, View
from omniscv.sources.pictures import read_picture, to_faces
from omniscv.storage.bounded import MOST_JSON_BYTES, MOST_PICTURE_BYTES, parse_json, read_bytes

_N = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
_M = np.diag([1.0, -1, -1])
_FRONT = cube_rotations()[0][1]
_FACES = {name: _FRONT.T @ R_w_c for name, R_w_c in cube_rotations()}  # from front's frame
_TARTAN = {"front": "front", "right": "right", "back": "back", "left": "left", "top": "up", "bottom": "down"}
_SAME = 2e-3  # of a rotation's entries: poses have six digits or fewer


@dataclass(frozen=True)
class Sequence:
    """Pictures with poses.

    Attributes:
        pictures: file, mode, rotation (3, 3) and position (3,) of the camera in the world, field of view in
            degrees, and encoding; without one the pixels are read, and encoded anew.
        objects: of masks.
        panoramas: whether pictures show all directions, and are resampled to six faces.
        layout: its name.
    """

    pictures: list[tuple[Path, str, Array, Array, float, str]]
    objects: ObjectTable = field(default_factory=lambda: ObjectTable({}))
    panoramas: bool = False
    layout: str = ""

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
                one = [(picture, _FRONT, fov_deg)]
                for pixels, R, face_deg in to_faces(picture, mode) if self.panoramas else one:
                    pose = Pose(t_w_c, R_w_c @ _FRONT.T @ R)
                    view = View(pose, face_deg, pixels.shape[1], pixels.shape[0])
                    yield Capture(Request(view, mode), view, pixels, provenance, *codecs.encode(pixels))


def _as_received(
    file: Path, mode: str, pose: Pose, fov_deg: float, encoding: str, provenance: dict[str, Any]
) -> Capture:
    payload = read_bytes(file, MOST_PICTURE_BYTES)
    try:
        view = View(pose, fov_deg, *codecs.picture_size(payload))
        pixels = codecs.decode(payload, encoding, mode, view)
    except BadReplyError as cause:
        raise ArgumentError(str(cause)) from cause
    return Capture(Request(view, mode), view, pixels, provenance, payload, encoding)


def find_sequence(folder: Path, layout: str = "auto") -> Sequence | None:
    """Return the frames of a folder, by what lies in it if no layout is named.

    Returns:
        None where it is none of these layouts, or another one is named.

    Raises:
        ArgumentError: files of a layout without poses, or poses that contradict each other.
    """
    matches = (name for name, (pattern, _) in SEQUENCES.items() if any(folder.glob(pattern)))
    name = next(matches, None) if layout == "auto" else layout
    if name not in SEQUENCES:
        return None
    try:
        sequence = SEQUENCES[name][1](folder)
    except ArgumentError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, OSError) as cause:
        got = f"{type(cause).__name__} {shown(str(cause))}"
        raise ArgumentError(f"expected a folder of layout {name}, got {got}") from cause
    if not sequence.pictures:
        raise ArgumentError(f"expected pictures of layout {name}, got none")
    return replace(sequence, layout=name)


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
    return Sequence(pictures, _classes(folder))


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


def _check_turned(file: Path, expected: Array, name: str) -> None:
    R_w_c, _ = _ned_poses(file)
    errors = np.abs(R_w_c - expected).max(axis=(1, 2)) if len(R_w_c) == len(expected) else np.ones(1)
    if errors.max() > _SAME:
        line = int(errors.argmax())
        angle = np.degrees(Rotation.from_matrix(R_w_c[line].T @ expected[line]).magnitude())
        raise ArgumentError(
            f"{file.name} line {line + 1}: expected the front's turned {name}, off by {angle:.3g} degrees"
        )


def _classes(folder: Path) -> ObjectTable:
    """The classes of masks as objects: ``name_map`` of seg_label_map.json, here or beside the sequences."""
    for place in (folder, *folder.absolute().parents[:2]):
        if (place / "seg_label_map.json").exists():
            ids = parse_json(read_bytes(place / "seg_label_map.json", MOST_JSON_BYTES)).get("name_map", {})
            return ObjectTable({}, 0, {str(name): int(i) for name, i in ids.items()})
    return ObjectTable({})


def _ob3d(folder: Path) -> Sequence:
    pictures = []
    for file in sorted((folder / "cameras").glob("*_cam.json")):
        number = file.name.removesuffix("_cam.json")
        with within(file.name):
            outer = parse_json(read_bytes(file, MOST_JSON_BYTES))[0]["extrinsics"]
            # The nearest rotation, because files have six digits:
            R_c_w = Rotation.from_matrix(np.array(outer["rotation"], float)).as_matrix()
            t_w_c = -R_c_w.T @ np.array(outer["translation"], float)
        for kind, ending, mode in (("images", "rgb.png", "lit"), ("depths", "depth.exr", "depth")):
            picture = folder / kind / f"{number}_{ending}"
            if picture.exists():
                pictures.append((picture, mode, R_c_w.T, t_w_c, 360.0, ""))
    return Sequence(pictures, panoramas=True)


SEQUENCES: dict[str, tuple[str, Callable[[Path], Sequence]]] = {
    "ob3d": ("cameras/*_cam.json", _ob3d),
    "tartanground": ("*_metadata.json", _tartanair),
    "tartanair": ("image_?cam_front", _tartanair),
}
"""Layouts of frames with poses: what lies in their folders, and their readers."""
