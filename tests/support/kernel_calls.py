"""Calls of every kernel by every signature that it declares, as images, sensors and checks make them."""

import copy
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any
from unittest import mock

import numpy as np

import omniscv
from mock_server.compiled import Kernel
from omniscv import light
from omniscv.compose.layers import as_halves
from omniscv.depth.depth_pictures import DepthPictures, sample_depth
from omniscv.depth.ray_lookup import look_up
from omniscv.geometry import Pose, cube_rotations
from omniscv.geometry.precision import Precision
from omniscv.importing import overlap
from omniscv.planning import ImageRays
from omniscv.sensor import Sensor
from omniscv.sources.base import Request, View
from omniscv.sources.mesh.materials import Material, Skin, Texture, palette, shades
from omniscv.sources.mesh.tracing import Tracer
from omniscv.truth.spherical_fit import bfov

MODES = ("lit", "object_mask", "depth", "normals")
POSE = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=20)
_LOOKED_AT = 40
"""Calls of a signature of which the one with most data is taken."""

Call = tuple[Kernel, int, tuple[Any, ...]]


def recorded_calls() -> list[Call]:
    """Return kernels, indices of their signatures, and arguments, which nothing else holds."""
    calls: dict[tuple[str, int], Call] = {}
    counts: dict[tuple[str, int], int] = {}

    def record(kernel: Kernel, args: tuple[Any, ...]) -> None:
        for index, signature in enumerate(kernel.signatures):
            if not signature.pack(args, [], []):
                continue
            key = (kernel.full_name, index)
            counts[key] = counts.get(key, 0) + 1
            known = calls.get(key)
            if counts[key] <= _LOOKED_AT and (known is None or _size(args) > _size(known[2])):
                calls[key] = (kernel, index, copy.deepcopy(args))
            return

    with _recorded(record):
        _draw_images()
        _use_others()
    for kernel, index, args in list(calls.values()):
        # Pixels of more than 2^31 are counted in 64 bits.
        wide = _widened(args)
        if index == 0 and len(kernel.signatures) == 2 and kernel.signatures[1].pack(wide, [], []):
            calls[kernel.full_name, 1] = (kernel, 1, wide)
    return list(calls.values())


@contextmanager
def _recorded(record: Any) -> Any:
    """Tell ``record`` of each call of a kernel."""
    call = Kernel.__call__

    def recording(kernel: Kernel, *args: Any) -> Any:
        record(kernel, args)
        return call(kernel, *args)

    def prepare(kernel: Kernel, *args: Any) -> Any:
        return partial(recording, kernel, *args)

    with mock.patch.object(Kernel, "__call__", recording), mock.patch.object(Kernel, "prepare", prepare):
        yield


def _draw_images() -> None:
    """Render a small image of every model, some with every filter, in bytes and floats, and some searched."""
    with omniscv.open_source("scene://four-wall") as source:
        for name in omniscv.cameras.names():
            camera = omniscv.cameras.model(name).example(16)
            one_way = camera.central or ImageRays(camera).scattered
            for strategy in ("auto",) if one_way else ("auto", "exact"):
                omniscv.render(camera, POSE, source, MODES, strategy=strategy, face_size=16)
        ring = omniscv.cameras.create("noncentral-panorama", width=16, height=8, radius=1.0)
        panorama = omniscv.cameras.model("equirectangular").example(32)
        for camera in (panorama, ring):
            omniscv.render(camera, POSE, source, MODES, accuracy=0.001, most_captures=60)
    with omniscv.open_source("scene://four-wall?traces=0") as source:
        omniscv.render(ring, POSE, source, MODES, viewpoints=4, strategy="exact")
        omniscv.render(ring, POSE, source, MODES, accuracy=0.001, most_captures=60)
        _sample_aside(source)
    with omniscv.open_source("scene://flat") as source:
        omniscv.render(panorama, POSE, source, ("lit",))
    for address in ("scene://four-wall", "scene://four-wall?lit=float32", "mock://four-wall"):
        with omniscv.open_source(address) as source:
            for filter_name in ("nearest", "bilinear", "bicubic", "area"):
                omniscv.render(
                    panorama, POSE, source, MODES, face_size=16, filter=filter_name, normals="from-depth"
                )


def _sample_aside(source: omniscv.sources.Source) -> None:
    """Sample depth for rays that start beside the centre of six captured faces."""
    views = [View(Pose(POSE.position, R_w_c), 95.0, 24, 24) for _, R_w_c in cube_rotations()]
    faces = [capture.pixels for capture in source.capture([Request(view, "depth") for view in views])]
    directions = np.random.default_rng(2).normal(size=(500, 3))
    pictures = DepthPictures.of(faces, views, Precision(), len(directions))
    sample_depth(pictures, look_up(directions, views), views, False, 0.1 * directions)


def _use_others() -> None:
    """Call what images do not: sensors, codes of light, boxes on the sphere, lenses that bend to the side,
    and the agreement of pictures."""
    generator = np.random.default_rng(1)
    gradient = generator.random((24, 32, 3), dtype=np.float32)
    Sensor(read_noise=2.0, prnu=0.01).expose(gradient)
    light.encode(gradient, "srgb")
    as_halves(gradient[..., 0])
    panorama = omniscv.cameras.model("equirectangular").example(32)
    mask = np.zeros((panorama.height, panorama.width), np.bool_)
    mask[4:9, 6:12] = True
    bfov(mask, panorama.unproject(panorama.pixels()), rotated=True)
    lens = omniscv.cameras.create(
        "pinhole", width=32, height=24, fov_deg=80, distortion=(-0.1, 0.01, 0.001, -0.002)
    )
    lens.project(lens.unproject(lens.pixels()).directions)
    depth = 1 + generator.random((2, 24, 32), dtype=np.float32)
    points = np.concatenate(
        [
            generator.normal(size=(1, 200, 2)) * 0.2,
            np.ones((1, 200, 1)),
            1 + generator.random((1, 200, 1)),
            generator.random((1, 200, 2)) * (28, 20) + 2,
        ],
        axis=-1,
    )
    motion = np.eye(3, 4)[None] + 0.01 * generator.normal(size=(1, 3, 4))
    lenses = np.array([[20.0, 20.0, 16.0, 12.0]] * 2)
    how = (False, 0.3, 0.0, 1.0, 1.0, 0.0, 0.0)
    if find_spec("embreex"):
        _use_mesh(generator)
    overlap.agreement(points, motion, np.array([[0, 1]]), lenses, depth, depth.copy(), how, np.zeros((1, 2)))


def _use_mesh(generator: np.random.Generator) -> None:
    """Trace and shade a pile of triangles, of which some have holes."""
    vertices = generator.normal(size=(300, 3))
    faces = np.arange(300, dtype=np.int32).reshape(-1, 3)
    tracer = Tracer(vertices, faces, np.arange(100) % 2 == 0)
    rays = generator.normal(size=(500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = tracer.trace(np.zeros(3), rays)
    tracer.following(np.zeros(3), rays, hits.distance, np.full(500, -1, np.int32))
    material = Material(texture=Texture(generator.integers(0, 256, (4, 4, 4), np.uint8)))
    skin = Skin(
        faces, np.zeros(100, np.int32), vertices[:, :2].astype(np.float32), np.ones((300, 4), np.float32)
    )
    shades(palette([material], cut_blended=False), skin, hits.face, hits.weights)


def _size(value: Any) -> int:
    """Return the bytes of all arrays in arguments."""
    if isinstance(value, tuple):
        return sum(map(_size, value))
    return value.nbytes if isinstance(value, np.ndarray) else 0


def _widened(value: Any) -> Any:
    """Return arguments with int64 in place of int32."""
    if isinstance(value, np.ndarray):
        return value.astype(np.int64) if value.dtype == np.int32 else value.copy()
    if isinstance(value, tuple):
        items = [_widened(item) for item in value]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    return value
