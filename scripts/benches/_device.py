"""Images of random orientations on a device, from faces that it holds, or that come to it for each batch."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from importlib import import_module
from importlib.util import find_spec
from itertools import cycle
from statistics import median

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import grid_sample

from benches import Figure, Reference
from benches._faces import made_map
from omniscv.cameras import Camera, create
from omniscv.compose.renderer import Renderer
from omniscv.geometry import Pose
from omniscv.planning import ImageRays, RenderOptions
from omniscv.sources import Capabilities, Capture, ObjectTable, Request, Source
from omniscv.torch import Faces

MODES = ("lit", "object_mask", "depth")
BATCHES = (1, 8, 32)
COPIED_BYTES = 8
"""A pixel's colour, label and depth are about 16 bytes, which a copy of half of them reads and writes."""
WARM_UP, TURNS, LEAST_S = 3, 7, 0.05
SETS = 3
"""Faces and orientations that are used in turn: one set may fit into a device's cache."""
POSE = Pose((0, 0, 0), np.eye(3))


class Drawn(Source):
    """Faces of noise, of boxes of 20 objects, and of depth with 1 % of noise."""

    capabilities = Capabilities(modes=frozenset(MODES))

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._face = cache(self._drawn)

    def _drawn(self, mode: str, edge: int, side: int) -> np.ndarray:
        random = np.random.default_rng((self._seed, side))
        if mode == "lit":
            return random.integers(0, 256, (edge, edge, 3), dtype=np.uint8)
        if mode == "depth":
            return random.uniform(2.97, 3.03, (edge, edge)).astype(np.float32)
        boxes = random.integers(0, 20, (-(-edge // 16),) * 2, dtype=np.uint16)
        return boxes.repeat(16, 0).repeat(16, 1)[:edge, :edge].copy()

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            side = int(np.rint(request.view.pose.R_w_c[:, 2] @ (1, 2, 3))) + 3  # by the axis ahead
            yield Capture(request, request.view, self._face(request.mode, request.view.width, side))

    def objects(self) -> ObjectTable:
        return ObjectTable({}, ids={f"box-{i:02}": i for i in range(20)})


def measure(quick: bool, name: str) -> Iterator[Figure]:
    """Check images of a device against composed ones, and measure how many it makes a second."""
    edge, batches = (32, (1, 2)) if quick else (1024, BATCHES)
    device = torch.device(name)
    on_cuda = device.type == "cuda"
    card = torch.cuda.get_device_name(device) if on_cuda else "processor"
    table = f"{card}, PyTorch {torch.__version__}: 6 x {edge}² to {2 * edge}x{edge}"
    camera, center = create("equirectangular", width=2 * edge, height=edge), (0, 0, 0)
    sources = [Drawn(seed) for seed in range(SETS)]
    R_w_c = Rotation.random(4 * SETS, random_state=1).as_matrix().reshape(SETS, -1, 3, 3)
    layers = {"lit": MODES[:1], "lit, labels, depth": MODES}
    faces = {
        what: [Faces(source, center, modes, face_size=edge, device=device) for source in sources]
        for what, modes in layers.items()
    }
    pinned = {
        what: [
            {layer: on_host(tensor, on_cuda) for layer, tensor in each.tensors.items()} for each in of_sets
        ]
        for what, of_sets in faces.items()
    }
    compare(faces["lit, labels, depth"][0].render(camera, R_w_c[0]), sources[0], camera, R_w_c[0], edge)
    maps = [[sampling_map(camera, R, edge, device) for R in of_set] for of_set in R_w_c]
    planes = [in_atlas(source, edge, device) for source in sources]
    copied = [torch.randint(256, (2 * edge * edge, COPIED_BYTES), dtype=torch.uint8) for _ in range(SETS)]
    copied = [each.to(device) for each in copied]
    targets = [each.clone() for each in copied]
    least_s = 0.02 if quick else LEAST_S

    def rate(count: int, call: Callable[[int], object]) -> float:
        """Images a second, of a function of the number of a set that makes some."""
        return count / seconds(call, device, least_s)

    def resample(i: int, grids: Sequence[Tensor]) -> Tensor:
        return grid_sample(planes[i].expand(len(grids[i]), -1, -1, -1), grids[i], align_corners=False)

    limit = Reference("copy", rate(1, lambda i: targets[i].copy_(copied[i])))
    for batch in batches:
        turns = [np.resize(R, (batch, 3, 3)) for R in R_w_c]
        grids = [torch.stack([of_set[i % len(of_set)] for i in range(batch)]) for of_set in maps]
        peer = Reference("grid_sample", rate(batch, partial(resample, grids=grids)))
        del grids
        for what, of_sets in faces.items():
            against = {"peer": peer} if what == "lit" else {"limit": limit}
            name = f"{what}, batch {batch}"
            images = rate(batch, partial(render, of_sets, camera, turns))
            yield Figure(table, name, "images/s", images, **against)
            images = rate(batch, partial(upload_and_render, of_sets, pinned[what], camera, turns))
            yield Figure(table, f"{name}, faces uploaded", "images/s", images, **against)
    if find_spec("pytorch360convert") is None:
        print("pytorch360convert: expected, not installed; its row is left out")
        return
    c2e = import_module("pytorch360convert").c2e
    cubes = [torch.rand(6, 3, edge, edge, device=device) for _ in sources]
    other = rate(1, lambda i: c2e(cubes[i], edge, 2 * edge, cube_format="stack"))
    ours = rate(1, lambda i: faces["lit"][i].render(camera, R_w_c[i, 0]))
    yield Figure(table, "lit, one image", "images/s", ours, peer=Reference("pytorch360convert", other))


def render(faces: Sequence[Faces], camera: Camera, R_w_c: Sequence[np.ndarray], i: int) -> object:
    """Make the images of a set."""
    return faces[i].render(camera, R_w_c[i])


def upload_and_render(
    faces: Sequence[Faces],
    pinned: Sequence[Mapping[str, Tensor]],
    camera: Camera,
    R_w_c: Sequence[np.ndarray],
    i: int,
) -> object:
    """Make the images of a set, whose faces come to the device first."""
    for layer, tensor in faces[i].tensors.items():
        tensor.copy_(pinned[i][layer], non_blocking=True)
    return faces[i].render(camera, R_w_c[i])


def compare(
    found: Mapping[str, Tensor], source: Source, camera: Camera, R_w_c: np.ndarray, edge: int
) -> None:
    """Raise AssertionError unless images are those that omniscv composes."""
    nearest, bilinear = (RenderOptions("cube", face_size=edge, filter=f) for f in ("nearest", "bilinear"))
    for i, R in enumerate(R_w_c):
        pose = Pose((0, 0, 0), R)
        image = Renderer(source).render(camera, pose, MODES, nearest)
        labels, depth, lit = (found[name][i].cpu().numpy() for name in ("labels", "depth", "lit"))
        assert np.array_equal(labels, image.labels), np.count_nonzero(labels != image.labels)
        off = np.abs(depth[0] - image.depth)  # composed depth is rounded, by 1/32 of its bound at most
        assert (off <= image.depth_error).all(), off.max()
        blended = Renderer(source).render(camera, pose, MODES[:1], bilinear).lit
        off = np.abs(np.moveaxis(lit, 0, -1).astype(int) - blended)
        assert off.max() <= 1, off.max()


def sampling_map(camera: Camera, R_w_c: np.ndarray, edge: int, device: torch.device) -> Tensor:
    """Return (H, W, 2) where an image samples an atlas, as grid_sample wants it."""
    _, atlas, x, y = made_map(ImageRays(camera), Pose((0, 0, 0), R_w_c), edge)
    size = np.array(atlas.shape[::-1])
    grid = (2 * np.stack([x, y], axis=-1) + 1) / size - 1
    return torch.from_numpy(grid.reshape(camera.height, camera.width, 2).astype(np.float32)).to(device)


def in_atlas(source: Source, edge: int, device: torch.device) -> Tensor:
    """Return (1, 3, H, W) float32, the atlas of a source's colours."""
    views, atlas, *_ = made_map(ImageRays(create("equirectangular", width=64, height=32)), POSE, edge)
    faces = [capture.pixels for capture in source.capture(Request(view, "lit") for view in views)]
    return torch.from_numpy(np.moveaxis(atlas.picture(faces), -1, 0)[None].astype(np.float32)).to(device)


def on_host(tensor: Tensor, pinned: bool) -> Tensor:
    """Return a copy in the processor's memory, locked there where a device reads it."""
    return tensor.cpu().pin_memory() if pinned else tensor.clone()


def seconds(call: Callable[[int], object], device: torch.device, least_s: float) -> float:
    """Return the median seconds of a call, which takes the numbers of sets in turn; as many calls at a time
    as take ``least_s``."""
    sets = cycle(range(SETS))

    def took(count: int) -> float:
        if device.type != "cuda":
            started = time.perf_counter()
            for _ in range(count):
                call(next(sets))
            return time.perf_counter() - started
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        for _ in range(count):
            call(next(sets))
        end.record()
        end.synchronize()
        return start.elapsed_time(end) / 1e3

    took(WARM_UP)
    count = max(1, math.ceil(WARM_UP * least_s / took(WARM_UP)))
    return median(took(count) / count for _ in range(TURNS))
