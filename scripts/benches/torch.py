"""How fast PyTorch is fed: from a recording and from shards; with --device, images that a device makes.

Panoramas of 512 x 256 in lit, labels and depth, a new orientation each, from faces of 256 px. "faces kept"
samples faces that are decoded already; "faces read each time" decodes them for every image, as omniscv.render
does. Shards are compared with decoding the same files. Images use both cores, or two workers of one thread
each; the best of several turns.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

import omniscv
from benches import Figure, Reference, best_ms
from omniscv.geometry import Pose
from omniscv.planning import RenderOptions

MODES = ("lit", "object_mask", "depth")
LAYERS = ("lit", "labels", "depth")
CENTER = (0, 0, 1.5)


def measure(quick: bool, device: str = "") -> Iterator[Figure]:
    import torch

    if device:
        from benches import _device

        yield from _device.measure(quick, device)
        return
    count, turns, width = (2, 1, 32) if quick else (16, 3, 512)
    cv2.setNumThreads(2)
    torch.set_num_threads(1)  # on a busy machine its threads wait for each other
    camera = omniscv.cameras.create("equirectangular", width=width, height=width // 2)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "room.sqlite"
        options = RenderOptions("cube", face_size=max(8, width // 2))
        with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
            omniscv.Renderer(source).render(camera, Pose.from_angles(CENTER), MODES, options)
        yield from on_the_fly(path, camera, count, turns)
        yield from from_shards(path, camera, count, turns)


def on_the_fly(path: Path, camera: omniscv.cameras.Camera, count: int, turns: int) -> Iterator[Figure]:
    """Compare images around one optical centre."""
    from torch.utils.data import DataLoader

    from omniscv.torch import Faces, RandomTurns, RecordingDataset

    draw = RandomTurns((camera,), pitch_deg=(-20, 20))
    kept = RecordingDataset(path, draw, MODES, per_center=count)
    fresh = RecordingDataset(path, draw, MODES, per_center=count)
    fresh.cache_bytes = 0
    poses = [record["record"].pose for record in kept]
    with omniscv.open_source(path) as source:
        renderer, faces = omniscv.Renderer(source), Faces(source, CENTER, MODES)
        R_w_c = np.array([pose.R_w_c for pose in poses])
        workers = DataLoader(kept, batch_size=4, num_workers=2, persistent_workers=True)
        ways: dict[str, Callable[[], object]] = {
            "faces kept": lambda: [kept[i] for i in range(count)],
            "faces kept, a batch at once": lambda: faces.render(camera, R_w_c),
            "faces kept, two workers": lambda: list(workers),
            "faces read each time": lambda: [fresh[i] for i in range(count)],
            "omniscv.render": lambda: [renderer.render(camera, pose, MODES) for pose in poses],
        }
        yield from figures("on the fly from a recording", best_ms(ways, turns), count, "omniscv.render")


def from_shards(path: Path, camera: omniscv.cameras.Camera, count: int, turns: int) -> Iterator[Figure]:
    """Compare shards with the decoding of their files."""
    from torch.utils.data import DataLoader

    from omniscv.torch import ShardDataset

    folder = path.parent
    with omniscv.open_source(path) as source, omniscv.dataset.Writer(folder / "dataset") as writer:
        for i in range(count):
            image = omniscv.render(camera, Pose.from_angles(CENTER, yaw_deg=10 * i), source, MODES)
            writer.add(f"image-{i}", image)
    omniscv.dataset.export(folder / "dataset", "webdataset", folder / "shards", max_count=max(1, count // 4))
    frames, shards = omniscv.dataset.open(folder / "dataset"), ShardDataset(folder / "shards", LAYERS)
    workers = DataLoader(shards, batch_size=4, num_workers=2, persistent_workers=True)
    ways: dict[str, Callable[[], object]] = {
        "shards": lambda: list(shards),
        "shards, two workers": lambda: list(workers),
        "decoding alone": lambda: [decoded(frame) for frame in frames],
    }
    yield from figures("from shards", best_ms(ways, turns), count, "decoding alone")


def decoded(frame: omniscv.dataset.Frame) -> Sequence[object]:
    """Return the layers of a frame on disk."""
    return [frame.layer(name) for name in LAYERS]


def figures(title: str, took: dict[str, float], count: int, peer: str) -> Iterator[Figure]:
    """Yield images a second of every way, compared with one of them."""
    rates = {name: 1e3 * count / ms for name, ms in took.items()}
    other = Reference(peer, rates.pop(peer))
    for name, rate in rates.items():
        yield Figure(title, name, "images/s", rate, peer=other)
