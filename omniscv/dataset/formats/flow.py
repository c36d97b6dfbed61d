"""Optical flow between consecutive frames of each camera: ``flow/STEM.flo`` and ``flow/STEM.exr``.

Frames are in the order of their times, or of their keys where a frame has no time. Between frames of
different scenes, or states of a world that moves, there is no flow, unless both have poses of objects, which
then are what differs.

``.flo`` (Middlebury)
    float32, px; 1e10 where the flow is not known.
``.exr``
    ``flow.X``, ``flow.Y`` in px (NaN where not known), and ``mask``: 0 not known, 1 known, 2 at infinity
    (the sky, which only turns), 3 occluded in the other frame.
``flow.json``
    the options, and which frame the flow of each leads to.

Objects move where both frames have their poses: ``poses`` in STEM.truth.json, by name, each with position and
rotation. An object with a pose in only one of them has no flow, nor has one that moves in images of a
rolling-shutter camera, whose lines show it at other times than that of its pose.

Options: ``gap`` (default 1), how many frames further the other one is; ``wrap``, ``shortest`` (default:
across the seam where that is shorter) or ``classic``; ``backward``, write ``STEM.backward.*`` too, from a
frame to the one before it; ``scene``, write ``STEM.sceneflow.exr`` too, ``sceneflow.X .Y .Z``, metres that
points move in the world; ``kitti``, write ``STEM.png`` too, 16 bits as KITTI, which flow of 512 px or more
does not fit; ``tolerance``, ``{abs_m: 0.02, rel: 0.01}``: how much nearer the other frame's depth must be for
a point to be occluded, in metres or as a share of the distance, whichever is more.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv import truth
from omniscv.arguments import Reader, fields, flag, number, numbers, one_of, whole_number, within
from omniscv.cameras import Camera, Rays, RollingShutter
from omniscv.compose.files import write_json, write_picture
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.modalities import Modality
from omniscv.planning.densities import unproject
from omniscv.storage.local import whole_file
from omniscv.truth.optical_flow import INVALID, Wrap, motion

name = "flow"
needs = ("depth",)
keys = ("tolerance",)

_OPTIONS: dict[str, Reader] = {
    "gap": whole_number,
    "wrap": partial(one_of, words=get_args(Wrap)),
    **dict.fromkeys(("backward", "scene", "kitti"), flag),
    "tolerance": partial(fields, readers=dict.fromkeys(("abs_m", "rel"), partial(number, least=0))),
}
_DEFAULTS = {
    "gap": 1, "wrap": "shortest", "backward": False, "scene": False, "kitti": False, "tolerance": {},
}  # fmt: skip
_TOLERANCE = {"abs_m": 0.02, "rel": 0.01}

_POSE: dict[str, Reader] = {
    "position": partial(numbers, shape=(3,)),
    "rotation": partial(numbers, shape=(3, 3)),
}
_FLOW = Modality("flow", ("float32",), 3, "nearest", "exr", ("flow.X", "flow.Y", "mask"), {"unit": "px"})
_SCENE = Modality(
    "sceneflow", ("float32",), 3, "nearest", "exr", ("sceneflow.X", "sceneflow.Y", "sceneflow.Z"),
    {"unit": "metre", "frame": "world: X forward, Y left, Z up"},
)  # fmt: skip
_PNG = Modality("flow", ("uint16",), 3)
_UNKNOWN = 1e10
_FLO_MAGIC = b"PIEH"  # float32 202021.25
_KITTI_STEPS, _KITTI_ZERO = 64, 1 << 15


def refuses(camera: Camera) -> str | None:
    """Return None: every camera has flow."""
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields("", options, _OPTIONS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the flow of frames with depth.

    Raises:
        ArgumentError: a frame without depth, a wrong option, or flow that does not fit KITTI's PNG.
    """
    given: dict[str, Any] = {**_DEFAULTS, **fields("", options, _OPTIONS)}
    given["tolerance"] = {**_TOLERANCE, **given["tolerance"]}
    folder = out / "flow"
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    targets = {}
    for mine in by_camera(frames).values():
        for stem, target, found in _flows(mine, given):
            targets[stem] = target
            written += _write_one(folder, stem, found, given)
    return [*written, write_json(folder / "flow.json", {**given, "to": targets})]


def _flows(frames: Sequence[Frame], given: Mapping[str, Any]) -> Iterator[tuple[str, str, truth.Flow]]:
    """Stem, key of the other frame and flow, of the frames of one camera."""
    gap = given["gap"]
    if len(frames) <= gap:
        return
    rays = unproject(frames[0].camera, frames[0].camera.pixels())
    for before, after in zip(frames, frames[gap:], strict=False):
        changed = (before.scene, before.state) != (after.scene, after.state)
        if changed and not (_object_poses(before) and _object_poses(after)):
            continue
        yield before.key, after.key, between(before, after, rays, given)
        if given["backward"]:
            yield f"{after.key}.backward", before.key, between(after, before, rays, given)


def between(first: Frame, second: Frame, rays: Rays, given: Mapping[str, Any]) -> truth.Flow:
    """Return the flow from a frame to another one; ``rays`` are those of the first one's camera."""
    labels = first.layers("labels").get("labels")
    motions = {} if labels is None else _motions(first, second)
    tolerance = given["tolerance"]
    return truth.flow(
        _sure_depth(first), rays, first.pose, second.camera, second.pose, _sure_depth(second), labels,
        motions, wrap=given["wrap"], tolerance_m=tolerance["abs_m"], tolerance_rel=tolerance["rel"],
    )  # fmt: skip


def _sure_depth(frame: Frame) -> NDArray[np.float32]:
    """Depth; 0 where it is not sure."""
    depth = frame.layer("depth")
    return np.where(frame.layers("unsure").get("unsure", False), np.float32(0), depth)


def _motions(first: Frame, second: Frame) -> dict[int, Pose | None]:
    """By instance id, how the objects with poses move; None where one of the poses is missing, or where
    lines show objects at other times than the poses are of."""
    was, is_now = (_object_poses(frame) for frame in (first, second))
    at_once = not any(_reads_lines(frame.camera) for frame in (first, second))
    return {
        first.instances[each]: motion(was[each], is_now[each])
        if each in was and each in is_now and (at_once or _same(was[each], is_now[each]))
        else None
        for each in sorted(was.keys() | is_now.keys())
        if each in first.instances
    }


def _reads_lines(camera: Camera) -> bool:
    return isinstance(camera, RollingShutter) and camera.readout > 0


def _same(one: Pose, other: Pose) -> bool:
    return one.to_dict() == other.to_dict()


def _object_poses(frame: Frame) -> dict[str, Pose]:
    given = frame.truth.get("poses", {})
    with within(frame.key):
        readers = dict.fromkeys(given, partial(fields, readers=_POSE, needed=_POSE))
        return {each: Pose(**pose) for each, pose in fields("poses", given, readers).items()}


def _write_one(folder: Path, stem: str, found: truth.Flow, given: Mapping[str, Any]) -> Iterator[Path]:
    pixels = found.pixels.astype(np.float32)
    with whole_file(flo := folder / f"{stem}.flo") as part:
        part.write_bytes(flo_bytes(pixels))
    yield flo
    mask = found.mask[..., None].astype(np.float32)
    yield write_picture(folder / f"{stem}.exr", np.concatenate([pixels, mask], axis=-1), _FLOW)
    if given["scene"]:
        yield write_picture(folder / f"{stem}.sceneflow.exr", found.scene.astype(np.float32), _SCENE)
    if given["kitti"]:
        with within(stem):
            yield write_picture(folder / f"{stem}.png", kitti_codes(found), _PNG)


def flo_bytes(pixels: NDArray[np.float32]) -> bytes:
    """Return the Middlebury file of flow (H, W, 2) px; what is NaN is not known."""
    height, width = pixels.shape[:2]
    values = np.where(np.isnan(pixels), np.float32(_UNKNOWN), pixels).astype("<f4")
    return _FLO_MAGIC + struct.pack("<ii", width, height) + values.tobytes()


def kitti_codes(found: truth.Flow) -> NDArray[np.uint16]:
    """Return KITTI's (H, W, 3) numbers of flow: ``64 u + 2^15``, ``64 v + 2^15``, and whether it is known.

    Raises:
        ArgumentError: flow beyond -512 to 512 px.
    """
    known = found.mask != INVALID
    codes = np.rint(_KITTI_STEPS * found.pixels[known] + _KITTI_ZERO)
    if codes.size and not (codes.min() >= 0 and codes.max() <= np.iinfo(np.uint16).max):
        largest = float(np.abs(found.pixels[known]).max())
        raise ArgumentError(
            f"kitti: expected flow within -512 to 511.98 px, got {largest:.2f} px; leave the option kitti "
            "out, or use wrap: shortest"
        )
    pixels = np.zeros((*known.shape, 3), np.uint16)
    pixels[known] = np.column_stack([codes, np.ones(len(codes))])
    return pixels
