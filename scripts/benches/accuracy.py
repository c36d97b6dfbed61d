"""What an asked accuracy costs, against the cheapest of the knobs that reaches it.

Cost is modelled: 5 ms a request and 25 ms a megapixel. The knobs are tried on a grid, with colours as fine as
the image needs; what would take more than 40 Mpx is extrapolated, because doubt falls as pixels shrink. The
grid has no view at every optical centre: these take 3,700 to 15,600 ms before they are made finer.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import omniscv
from benches import Figure, Reference
from omniscv import Pose
from omniscv.cameras import Camera, create
from omniscv.planning import ImageRays
from omniscv.sources.base import Capture, Request, Source, SourceWrapper
from omniscv.sources.scene import SceneSource, open_scene

SCENES = ("four-wall", "six-wall", "open", "fence")
AIMS = (0.03, 0.02, 0.01, 0.005, 0.003, 0.002, 0.001)
MODES = ("lit", "object_mask", "depth")
POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20.0)
MOST_MPX = 40.0
SCALES = (1, 2, 3, 4, 6, 8)
WIDER = (1.0, 1.25, 1.5)
"""Sizes of faces as multiples of the automatic one."""
WAYS: tuple[dict[str, Any], ...] = (
    *({"viewpoints": count, "accuracy": 0.2} for count in (None, 2, 4, 16)),
    {"strategy": "exact", "viewpoints": 16},
    {"strategy": "cube", "viewpoints": 16},
)  # fmt: skip
QUICK = {"four-wall": ("panorama 64",)}


@dataclass(frozen=True)
class Tried:
    """What a way to make an image took, modelled ms, and the share of its pixels that are doubtful."""

    ms: float
    doubtful: float


class Counted(SourceWrapper):
    """Counts requests and pixels, and those of ground truth."""

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self.requests = self.pixels = self.truth = 0

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            area = request.view.width * request.view.height
            self.requests, self.pixels = self.requests + 1, self.pixels + area
            self.truth += area * (request.mode != "lit")
            yield from self._source.capture([request])


def cameras() -> dict[str, Camera]:
    """Return the cameras by name."""
    widths = (64, 1024, 2048, 4096, 8192)
    return {
        **{f"panorama {w}": create("equirectangular", width=w, height=w // 2) for w in widths},
        "fisheye": create("fisheye-equidistant", **square(512)),
        "kannala-brandt": create("kannala-brandt", **square(640), fx=200.0, fy=200.0, fov_deg=180.0),
        "pinhole": create("pinhole", width=640, height=480, fov_deg=90.0),
        "hyperbolic mirror": create(
            "catadioptric-hyperbolic", **square(384), semi_latus_rectum=0.4, distance=1.0, focal=180.0
        ),
        "non-central 0.4 m": create("noncentral-panorama", width=512, height=256, radius=0.4),
        "non-central 1 m": create("noncentral-panorama", width=256, height=128, radius=1.0),
        "mirror ball": create("noncentral-spherical-mirror", **square(192), mirror_radius=0.3, distance=0.3),
        "mirror cone": create("noncentral-conical-mirror", **square(192), half_angle_deg=55.0, distance=0.3),
    }  # fmt: skip


def square(edge: int) -> dict[str, int]:
    return {"width": edge, "height": edge}


def measure(quick: bool) -> Iterator[Figure]:
    known = cameras()
    chosen = QUICK if quick else {scene: tuple(known)[1:] for scene in SCENES}
    for scene, names in chosen.items():
        for name in names:
            tried = grid(scene, known[name], SCALES[:2] if quick else SCALES)
            for aim in AIMS[:1] if quick else AIMS:
                found = made(scene, known[name], {"accuracy": aim})
                yield figure(f"{scene}, {name}", aim, found, tried.values())


def figure(title: str, aim: float, found: Tried, tried: Any) -> Figure:
    """Return the row of an aim: what it cost, against the cheapest setting that reaches it."""
    least = min((each.ms for each in tried if each.doubtful <= aim), default=None)
    reached = "" if found.doubtful <= aim else f", reached {100 * found.doubtful:.3g} %"
    cheapest = None if least is None else Reference("cheapest of the grid", least)
    return Figure(title, f"at most {100 * aim:g} % doubtful{reached}", "ms", found.ms, cheapest)


def grid(scene: str, camera: Camera, scales: tuple[int, ...] = SCALES) -> dict[str, Tried]:
    """Return what the settings of a grid take, and the doubt that is left."""
    edge = ImageRays(camera).face_size
    ways = [{"face_size": int(edge * wider)} for wider in WIDER] if camera.central else WAYS
    tried: dict[str, Tried] = {}
    for way in ways:
        scale = 1
        of_scale, mpx = counted(scene, camera, {**way, "truth_scale": scale})
        for finer in scales if "strategy" not in way else scales[:1]:
            more = (finer / scale) ** 2 * mpx
            if finer > scale and more <= MOST_MPX:
                scale = finer
                of_scale, mpx = counted(scene, camera, {**way, "truth_scale": scale})
                more = mpx
            tried[f"{way} x{finer}"] = Tried(
                of_scale.ms + 25.0 * (more - mpx), of_scale.doubtful * scale / finer
            )
    return tried


def made(scene: str, camera: Camera, way: Mapping[str, Any]) -> Tried:
    """Return what an image took."""
    return counted(scene, camera, way)[0]


def counted(scene: str, camera: Camera, way: Mapping[str, Any]) -> tuple[Tried, float]:
    """Return what an image took, and the megapixels of its ground truth."""
    with Counted(SceneSource(open_scene(f"scene://{scene}").scene, cached_views=6)) as source:
        image = omniscv.render(camera, POSE, source, MODES, **way)
    return Tried(5.0 * source.requests + 25e-6 * source.pixels, image.doubtful), source.truth / 1e6
