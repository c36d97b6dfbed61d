"""The truth ``flow`` as files, between the frames of each camera: ``flow/STEM.flo`` and ``flow/STEM.exr``.

``.flo`` (Middlebury) has float32, px, 1e10 where the flow is unknown; ``.exr`` has ``flow.X``, ``flow.Y`` in
px (NaN where unknown), and ``mask``: 0 unknown, 1 known, 2 at infinity (the sky, which only turns), 3
occluded in the other frame; ``flow.json`` the options, and the frame that each frame's flow leads to.

Frames of different scenes, or of different states of a world that moves, have flow only if both have poses of
objects. An object with a pose in only one of them has none. Neither has an object that moves in images of a
rolling-shutter camera, whose lines show it at other times than that of its pose.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import within
from omniscv.cameras import Rays
from omniscv.cameras.rolling_shutter import readout_of
from omniscv.compose.files import write_json, write_picture
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.modalities import Modality
from omniscv.planning.densities import unproject
from omniscv.storage.local import write_bytes
from omniscv.truth.optical_flow import INVALID, Flow, FlowOptions, flow, motion

_FLOW = Modality("flow", ("float32",), 3, "nearest", "exr", ("flow.X", "flow.Y", "mask"), {"unit": "px"})
_SCENE = Modality(
    "sceneflow", ("float32",), 3, "nearest", "exr", ("sceneflow.X", "sceneflow.Y", "sceneflow.Z"),
    {"unit": "metre", "frame": "world: X forward, Y left, Z up"},
)  # fmt: skip
_PNG = Modality("flow", ("uint16",), 3)
_UNKNOWN = 1e10
_FLO_MAGIC = b"PIEH"  # float32 202021.25
_KITTI_STEPS = 64
_KITTI_ZERO = 1 << 15


@register
class FlowFiles(Format):
    """See the module."""

    name = "flow"
    needs = ("depth",)
    keys = ("tolerance",)
    options = FlowOptions

    def write(self, frames: Sequence[Frame], out: Path, options: FlowOptions) -> list[Path]:
        """Write the flow of ``frames`` with depth into ``out/flow``, in the forms that ``options`` name.

        ArgumentError: flow that does not fit KITTI's PNG.
        """
        folder = out / "flow"
        written: list[Path] = []
        targets = {}
        for sequence in by_camera(frames).values():
            for stem, target, of_pair in _flows(sequence, options):
                targets[stem] = target
                written += _write_one(folder, stem, of_pair, options)
        return [*written, write_json(folder / "flow.json", {**asdict(options), "to": targets})]


def _flows(frames: Sequence[Frame], options: FlowOptions) -> Iterator[tuple[str, str, Flow]]:
    """Stem, key of the other frame and flow, of the frames of one camera."""
    if len(frames) <= options.gap:
        return
    rays_of = lru_cache(2)(lambda camera: unproject(camera, camera.pixels()))  # of one that moves, its own
    for before, after in zip(frames, frames[options.gap :], strict=False):
        changed = (before.scene, before.state) != (after.scene, after.state)
        if changed and not (_object_poses(before) and _object_poses(after)):
            continue
        yield before.key, after.key, between(before, after, rays_of(before.camera), options)
        if options.backward:
            yield f"{after.key}.backward", before.key, between(after, before, rays_of(after.camera), options)


def between(first: Frame, second: Frame, rays: Rays, options: FlowOptions) -> Flow:
    """Return the flow from a frame to another one.

    Args:
        first: in whose pixels the flow is.
        second: to which it leads.
        rays: of the pixels of the first frame's camera.
        options: of the format; ``wrap`` and ``tolerance`` are used.
    """
    labels = first.layer("labels") if "labels" in first.files else None
    return flow(
        _sure_depth(first),
        rays,
        first.pose,
        second.camera,
        second.pose,
        _sure_depth(second),
        labels,
        {} if labels is None else _motions(first, second),
        wrap=options.wrap,
        tolerance_m=options.tolerance.abs_m,
        tolerance_rel=options.tolerance.rel,
    )


def _sure_depth(frame: Frame) -> NDArray[np.float32]:
    """Depth; 0 where it is unsure."""
    unsure = frame.layer("unsure") if "unsure" in frame.files else False
    return np.where(unsure, np.float32(0), frame.layer("depth"))


def _motions(first: Frame, second: Frame) -> dict[int, Pose | None]:
    """By instance id, the motion of objects with poses; None without flow: see the module."""
    before = _object_poses(first)
    after = _object_poses(second)
    at_once = not (readout_of(first.camera) or readout_of(second.camera))
    motions: dict[int, Pose | None] = {}
    for name in sorted((before.keys() | after.keys()) & first.instances.keys()):
        instance = first.instances[name]
        motions[instance] = None
        if name in before and name in after:
            is_still = before[name].to_dict() == after[name].to_dict()
            if at_once or is_still:
                motions[instance] = motion(before[name], after[name])
    return motions


def _object_poses(frame: Frame) -> dict[str, Pose]:
    poses = {}
    for name, pose in frame.truth.get("poses", {}).items():
        poses[name] = Pose.from_dict(pose)
    return poses


def _write_one(folder: Path, stem: str, flow: Flow, options: FlowOptions) -> Iterator[Path]:
    """Write the files of a frame's flow, px, into a folder, and yield their paths.

    ``STEM.flo`` is Middlebury's; ``STEM.exr`` has the mask of what is known as a third channel; scene flow,
    metres in the world frame, and KITTI's PNG are written if the options ask for them.
    """
    pixels = flow.pixels.astype(np.float32)
    yield write_bytes(folder / f"{stem}.flo", flo_bytes(pixels))
    mask = flow.mask[..., None].astype(np.float32)
    yield write_picture(folder / f"{stem}.exr", np.concatenate([pixels, mask], axis=-1), _FLOW)
    if options.scene:
        yield write_picture(folder / f"{stem}.sceneflow.exr", flow.scene.astype(np.float32), _SCENE)
    if options.kitti:
        with within(stem):
            yield write_picture(folder / f"{stem}.png", kitti_codes(flow), _PNG)


def flo_bytes(pixels: NDArray[np.float32]) -> bytes:
    """Return the Middlebury file of flow (H, W, 2) px; NaN is unknown."""
    height, width = pixels.shape[:2]
    values = np.where(np.isnan(pixels), np.float32(_UNKNOWN), pixels).astype("<f4")
    return _FLO_MAGIC + struct.pack("<ii", width, height) + values.tobytes()


def kitti_codes(flow: Flow) -> NDArray[np.uint16]:
    """Return KITTI's (H, W, 3) numbers of flow: ``64 u + 2^15``, ``64 v + 2^15``, and whether it is known.

    Raises:
        ArgumentError: flow beyond -512 to 512 px.
    """
    known = flow.mask != INVALID
    codes = np.rint(_KITTI_STEPS * flow.pixels[known] + _KITTI_ZERO)
    if codes.size and not (codes.min() >= 0 and codes.max() <= np.iinfo(np.uint16).max):
        largest = float(np.abs(flow.pixels[known]).max())
        raise ArgumentError(
            f"kitti: expected flow within -512 to 511.98 px, got {largest:.2f} px; leave the option kitti "
            "out, or use wrap: shortest"
        )
    pixels = np.zeros((*known.shape, 3), np.uint16)
    pixels[known] = np.column_stack([codes, np.ones(len(codes))])
    return pixels
