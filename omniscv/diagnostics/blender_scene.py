"""The doctor of scenes for Blender: faults of a scene, and the time of a picture."""

import time

import numpy as np

from omniscv.diagnostics import Finding
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.sources.base import Request, View
from omniscv.sources.blender.process import TIMEOUT_S
from omniscv.sources.blender.source import BlenderSource, open_process

_EDGE_PX = 128
_FOV_DEG = 90.0
_BLACK = 1 / 255
_ELSEWHERE = "give --position where more is visible"
_PACK = "put them there, or pack them into the file"


def examine_blender(
    address: str, position: Array | None = None, timeout_s: float = TIMEOUT_S, patience_s: float | None = None
) -> list[Finding]:
    """Examine a scene by some ten small pictures.

    Args:
        address: ``blender://SCENE.blend``, with its options.
        position: (3,) world frame, metres; None: the scene's own camera, or the middle of all objects.
        timeout_s: how long loading the scene, and each picture, may take.
        patience_s: not for Blender, which is started again at once.

    Raises:
        ArgumentError: a wrong address, or a patience.
        SourceError: there is no Blender, or it does not open the scene.
    """
    if patience_s is not None:
        raise ArgumentError("patience: expected none for Blender, which is started again at once")
    with open_process(address, timeout_s) as source:
        scene = source.blender.scene
        center = _center(source) if position is None else position
        lamps = len(scene.lights.keys() - {"World"})
        lights = f"{'a' if scene.world else 'no'} world, {lamps} lamps"
        is_lit = scene.world or lamps > 0
        objects = len(scene.objects)
        missing = f"{len(scene.missing)} missing"
        if scene.missing:
            missing += f", {scene.missing[0]}"
        return [
            Finding("Blender", f"{source.blender.version}; {source.scene_identity.level}"),
            Finding.unless(not scene.missing, "linked files", missing, "bad", _PACK),
            Finding.unless(is_lit, "light", lights, "warning", "add a world or lamps, or all is black"),
            Finding.unless(objects > 0, "objects", str(objects), "warning", "nothing is rendered"),
            *_colors(source, center),
        ]


def _center(source: BlenderSource) -> Array:
    """Return (3,) where the scene's own camera is, or else the middle of the corners of all boxes."""
    camera = source.blender.scene.camera
    if camera is not None:
        return np.array(camera)
    corners = [box.corners_w() for box in source.geometry().boxes.values()]
    if not corners:
        return np.zeros(3)
    return np.asarray(np.concatenate(corners).mean(axis=0))


def _colors(source: BlenderSource, center: Array) -> list[Finding]:
    """Measure whether colours show anything, whether they repeat, and how long a picture takes."""
    requests = []
    for _, R_w_c in cube_rotations():
        view = View(Pose(center, R_w_c), _FOV_DEG, _EDGE_PX, _EDGE_PX)
        requests.append(Request(view, "lit"))
    list(source.capture(requests[:1]))  # the first picture takes longer
    started = time.perf_counter()
    first = [capture.pixels for capture in source.capture(requests)]
    seconds = (time.perf_counter() - started) / len(requests)
    again = next(iter(source.capture(requests[:1]))).pixels
    mean = float(np.mean(first)) / (255 if first[0].dtype == np.uint8 else 1)
    same = np.array_equal(first[0], again)
    equality = "to the bit" if same else "not equal"
    return [
        Finding.unless(mean > _BLACK, "brightness", f"{mean:.3f} of 1 at the mean", "warning", _ELSEWHERE),
        Finding.unless(same, "same again", equality, "bad", "render on the CPU, without denoiser"),
        Finding("time", f"{seconds:.3f} s for the colours of {_EDGE_PX} x {_EDGE_PX} px"),
    ]
