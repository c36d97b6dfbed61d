"""What each strategy captures for a non-central panorama of 1024 x 512, and how long that takes.

Three modes over TCP from the mock server, with 0, 5 and 30 ms added to each reply; the peer is the paper's
cube, on a panorama of every 32nd column and multiplied. Memory is the most that the process takes for a
panorama of 2048 x 1024 by cube, in one mode. How right the images are is charted: ``omniscv chart``.
"""

import resource
import time
from collections.abc import Iterable, Iterator

import numpy as np

import mock_server
import omniscv
from benches import Figure, Reference
from omniscv import Pose, RenderOptions
from omniscv.cameras import Camera, create
from omniscv.planning import ImageRays
from omniscv.sources import Capture, Request
from omniscv.sources.base import Source, SourceWrapper
from omniscv.sources.scene import SceneSource

POSE = Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0)
MODES = ("lit", "object_mask", "depth")


class Counted(SourceWrapper):
    """Counts the requests and the captured pixels."""

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self.requests = self.pixels = 0

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for capture in self._source.capture(requests):
            self.requests += 1
            self.pixels += capture.view.width * capture.view.height
            yield capture


def measure(quick: bool) -> Iterator[Figure]:
    width, share, latencies = (16, 4, (0,)) if quick else (1024, 32, (0, 5, 30))
    before = peak_mb()
    cube_of(panorama(2 * width, width), 16 if quick else 64)
    title = f"cube of {2 * width} x {width} in depth"
    yield Figure(title, "most memory", "MB", peak_mb(), Reference("before", before))
    whole, part = panorama(width, width // 2), panorama(width // share, width // 2)
    edge = 16 if quick else ImageRays(whole).face_size
    title = f"noncentral-panorama {width} x {width // 2}, three modes"
    cube = share * captured(part, "cube", edge, latencies)
    for strategy in ("strips", "adaptive"):
        found = captured(whole, strategy, edge, latencies)
        units = "requests", "Mpx", *(f"s at {ms} ms" for ms in latencies)
        for unit, ours, others in zip(units, found, cube, strict=True):
            yield Figure(title, strategy, unit, ours, Reference("cube", others))


def panorama(width: int, height: int) -> Camera:
    return create("noncentral-panorama", width=width, height=height, radius=1.0)


def captured(camera: Camera, strategy: str, face_size: int, latencies_ms: tuple[int, ...]) -> np.ndarray:
    """Return requests, captured megapixels, and seconds at each latency."""
    seconds = []
    for latency_ms in latencies_ms:
        with (
            mock_server.serve("four-wall", latency_ms=latency_ms) as server,
            Counted(omniscv.open_source(server.uri)) as source,
        ):
            started = time.perf_counter()
            omniscv.render(camera, POSE, source, MODES, strategy=strategy, face_size=face_size)
            seconds.append(time.perf_counter() - started)
    return np.array([source.requests, source.pixels / 1e6, *seconds])


def cube_of(camera: Camera, face_size: int) -> None:
    """Render an image by the paper's strategy."""
    source = SceneSource(mock_server.load_scene("four-wall"), cached_views=12)
    omniscv.Renderer(source).render(camera, POSE, ("depth",), RenderOptions("cube", face_size=face_size))


def peak_mb() -> float:
    """Return the most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
