"""How fast a panorama or a fisheye is composed from six decoded faces, its map kept.

A figure is a whole render. A limit is one ``cv2.remap`` by the same map, ready, of a picture that is ready.
Peers compose from the same faces. Two threads; all ways in turns; the best of fifteen.
"""

from collections.abc import Callable, Iterator
from functools import partial

import cv2

from benches import Figure, Reference, best_ms
from benches._faces import Noise, made_map
from omniscv import Renderer, RenderOptions, cameras
from omniscv.cameras import Camera
from omniscv.chart.peers import peers
from omniscv.geometry import Pose, cube_rotations
from omniscv.planning import Filter, ImageRays
from omniscv.sources import Request

POSE = Pose.from_angles((0, 0, 1.5), yaw_deg=20, pitch_deg=5)
FILTERS: tuple[Filter, ...] = ("nearest", "bilinear", "bicubic", "area")
FLOAT, FIXED = "cv2.remap, float map", "cv2.remap, map in 1/32 px"


def measure(quick: bool) -> Iterator[Figure]:
    turns, part = (1, 32) if quick else (15, 1)
    cv2.setNumThreads(2)
    for model, face_size, width, height, more in (
        ("equirectangular", 1024, 2048, 1024, {}),
        ("fisheye-equidistant", 1024, 1024, 1024, {"fov_deg": 185}),
        ("equirectangular", 2048, 256, 128, {}),
    ):
        camera = cameras.create(model, width=width // part, height=height // part, **more)
        took = best_ms(ways(camera, face_size // part), turns)
        title = f"6 x {face_size // part}^2 to {model} {camera.width} x {camera.height}"
        for each in ("nearest", "bicubic", "area"):
            yield Figure(title, each, "ms", took[each])
        for name, ms in took.items():
            kind = "limit" if name in (FLOAT, FIXED) else "peer"
            if name not in FILTERS:
                yield Figure(title, "bilinear", "ms", took["bilinear"], **{kind: Reference(name, ms)})


def ways(camera: Camera, face_size: int) -> dict[str, Callable[[], object]]:
    """Return omniscv's filters, the limits and, for panoramas, the peers; all of the same faces."""
    source = Noise()

    def renders(filter: Filter) -> Callable[[], object]:
        renderer, options = Renderer(source), RenderOptions("cube", face_size=face_size, filter=filter)
        return lambda: renderer.render(camera, POSE, ("lit",), options)

    views, atlas, x, y = made_map(ImageRays(camera), POSE, face_size)
    faces = [capture.pixels for capture in source.capture(Request(view, "lit") for view in views)]
    picture = atlas.picture(faces)
    maps = x.reshape(camera.height, camera.width), y.reshape(camera.height, camera.width)
    fixed = cv2.convertMaps(*maps, cv2.CV_16SC2)
    found: dict[str, Callable[[], object]] = {each: renders(each) for each in FILTERS}
    for name, ready in ((FLOAT, maps), (FIXED, fixed)):
        found[name] = partial(cv2.remap, picture, *ready, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    if camera.name == "equirectangular":
        square = source.face(face_size)
        found |= peers({name: square for name, _ in cube_rotations()}, camera)
    return found
