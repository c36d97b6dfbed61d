"""What an image claims of itself holds, at every scale: wrong pixels are marked, and marks are not cheap."""

from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from support.exact import by_rays, distance_to_surfaces
from support.judged import Errors

import mock_server
import omniscv
from omniscv.cameras import create, model, names
from omniscv.geometry import Pose
from omniscv.pictures import png
from omniscv.sources import codecs
from omniscv.sources.base import SourceWrapper
from omniscv.sources.recording import Recording

MODES = ("object_mask", "depth")
UNCOVERED = 0.0005
"""Of the valid pixels: tips of wedges between pixels, creases within the noise of half floats."""
TURNING = {"velocity": (10, 3, 2), "angular_velocity_deg": (100, -200, 300), "readout": 0.03}
SMALL = {
    name: create(name, width, height, **parameters)
    for name, width, height, parameters in (
        ("noncentral-panorama", 64, 32, {"radius": 1.0}),
        ("noncentral-spherical-mirror", 64, 64, {"mirror_radius": 0.3, "distance": 0.3, "fov_deg": 280}),
        ("rolling-shutter", 64, 48, {"base": {"model": "fisheye-equidistant", "fov_deg": 150}, **TURNING}),
        ("push-broom", 80, 60, {"travel": (1.5, 0.1, -0.2)}),
    )
}
WAYS = ({"strategy": "exact"}, {}, {"strategy": "exact", "viewpoints": 12})
SHARED = {"accuracy": 0.1}  # shared viewpoints without many rounds
FLOATS = "four-wall?traces=0"  # nothing is as large as rounding depth and pixels to float32
ROOMS = ("four-wall", "open", "fence", FLOATS)


@pytest.fixture(scope="module")
def rooms():
    with ExitStack() as opened:
        uris = {name: f"{'scene' if '?' in name else 'mock'}://{name}" for name in ROOMS}
        sources = {name: opened.enter_context(omniscv.open_source(uri)) for name, uri in uris.items()}
        yield {name: (mock_server.load_scene(name.partition("?")[0]), sources[name]) for name in ROOMS}


def drawn_pose(seed):
    """A pose whose numbers are not round: walls at round distances have no rounding error."""
    rng = np.random.default_rng(seed)
    position = rng.uniform((-0.3, -0.3, 1.2), (0.3, 0.3, 1.8))
    return Pose.from_angles(position, *rng.uniform(-20, 20, 3))


FACE_PX = 192
FEW_UNSURE = 0.005  # of the valid pixels: ten of an image here, too few for a share of them to say much

CASES = [
    *(
        (*each.values, "four-wall", {})
        for each in by_rays(names(), dear=("unified", "lidar", "cube-map", "octahedral"))
        if model(*each.values).central and not each.marks
    ),
    ("equirectangular", "open", {}),
    ("equirectangular", FLOATS, {}),
    pytest.param("noncentral-spherical-mirror", FLOATS, {}, marks=pytest.mark.soak),
    ("fisheye-equidistant", "fence", {}),
    ("noncentral-panorama", "fence", WAYS[2]),
    ("noncentral-spherical-mirror", "open", WAYS[1]),
    ("rolling-shutter", "fence", WAYS[0]),
    ("push-broom", "four-wall", WAYS[2]),
]


def ids(value):
    return "-".join(map(str, value.values())) if isinstance(value, dict) else value


@pytest.mark.parametrize(("name", "room", "way"), CASES, ids=ids)
def test_what_is_wrong_is_marked(name, room, way, rooms):
    scene, source = rooms[room]
    camera = SMALL[name] if name in SMALL else model(name).example(96)
    image = omniscv.render(camera, drawn_pose(0), source, MODES, face_size=FACE_PX, **way)
    found = Errors(image, scene, FACE_PX / 2)
    assert found.uncovered.sum() <= max(2, UNCOVERED * image.valid.sum())
    assert image.unsure[image.valid].mean() <= FEW_UNSURE or found.unsure_wrong() >= 0.2
    assert not image.unsure[~image.valid].any()
    assert (image.depth_error[~image.valid] == 0).all()
    assert (image.depth[image.valid] > 0).all()


def test_the_bound_of_depth_is_near_its_error(rooms):
    """Half floats round a wall by one amount: many poses are needed for the median of all."""
    errors = []
    bounds = []
    for name in ("equirectangular", "fisheye-equidistant", "noncentral-panorama"):
        camera = SMALL[name] if name in SMALL else model(name).example(96)
        for seed in range(2):
            scene, source = rooms[("four-wall", "fence")[seed % 2]]
            way = (WAYS[0], SHARED)[seed % 2] if name in SMALL else {}
            image = omniscv.render(camera, drawn_pose(seed), source, MODES, face_size=96, **way)
            errors.append(Errors(image, scene).depth_m[image.valid])
            bounds.append(image.depth_error[image.valid])
    bound = np.median(np.concatenate(bounds))
    error = np.median(np.concatenate(errors))
    # What rounding adds: 1/32 of the surface's own bound, and the last of six binary digits.
    assert bound <= 2.97 * (1 + 1 / 32) ** 2 * error


@pytest.mark.parametrize("name", ["equirectangular", "noncentral-panorama"])
def test_no_point_hangs_in_the_open(name, rooms):
    """400 m of ground, a post of 0.1 m, a tower of 80 m (review, A6)."""
    scene, source = rooms["open"]
    camera = SMALL.get(name) or model(name).example(256)
    way = SHARED if name in SMALL else {}
    image = omniscv.render(camera, drawn_pose(3), source, MODES, face_size=256, **way)
    shown = image.valid & np.isfinite(image.depth)
    away = distance_to_surfaces(scene, image.points())
    bounded = np.isfinite(image.depth_error[shown])
    near = away <= np.maximum(0.05, 0.01 * image.depth[shown])
    assert near[bounded].all()
    assert near.all() or not image.camera.central


def test_what_is_farther_than_the_wire_reaches_is_told_from_the_sky():
    """Centimetres in half floats end at 655 m: a wall beyond has a label, endless depth, and is unsure."""
    wall = {"solids": [{"box": [2.0, 400.0, 300.0], "at": [900.0, 0.0, 150.0]}]}
    scene = mock_server.scene.Scene("far", {"sky": [0.5, 0.7, 1.0], "objects": {"Wall": wall}})
    with mock_server.serve(scene) as server, omniscv.open_source(server.uri) as source:
        image = omniscv.render(create("equirectangular", 64, 32), drawn_pose(0), source, MODES)
    beyond = image.labels > 0
    sky = ~beyond & ~image.label_edge
    assert np.isposinf(image.depth).all()
    assert beyond.any()
    assert image.unsure[beyond].all()
    assert not image.unsure[sky].any()
    assert (image.depth_error[sky] == 0).all()
    assert np.isposinf(image.depth_error[beyond]).all()


@pytest.mark.parametrize(
    ("normals", "most"), [("captured", 0.001), pytest.param("from-depth", 0.02, marks=pytest.mark.soak)]
)
def test_normals_lie_on_a_surface(normals, most, rooms):
    """No normal is blended across an edge: nearly all are those of a surface within a pixel (review, A5)."""
    scene, source = rooms["four-wall"]
    for name, way in (("equirectangular", {}), ("noncentral-panorama", WAYS[0])):
        camera = SMALL.get(name) or model(name).example(96)
        modes = (*MODES, "normals")
        image = omniscv.render(camera, drawn_pose(2), source, modes, face_size=192, normals=normals, **way)
        assert Errors(image, scene).normals_off() <= most


class Inexact(SourceWrapper):
    """A scene whose depth comes in whole millimetres, or off by up to 1 mm and 0.1 % and saying so."""

    def __init__(self, source, whole):
        super().__init__(source)
        self._whole = whole
        self._rng = np.random.default_rng(0)

    @property
    def capabilities(self):
        error = (0.0, 0.0) if self._whole else (0.001, 0.001)
        return replace(self._source.capabilities, depth_error=error)

    def capture(self, requests):
        for capture in self._source.capture(requests):
            if capture.mode != "depth":
                yield capture
            elif self._whole:
                stored = np.where(capture.pixels < np.inf, np.round(capture.pixels * 1000), 0)
                payload = png.encode(stored.astype(np.uint16))
                encoding = "png uint16 1000"
                depth = codecs.decode(payload, encoding, "depth", capture.view)
                yield replace(capture, pixels=depth, payload=payload, encoding=encoding)
            else:
                off = self._rng.uniform(-0.99, 0.99, capture.pixels.shape) * (0.001 + 0.001 * capture.pixels)
                yield replace(capture, pixels=(capture.pixels + off).astype(np.float32))


@pytest.mark.parametrize(
    ("camera", "whole", "way"),
    [
        (create("fisheye-equidistant", 96, 96, fov_deg=170), False, {}),
        (create("noncentral-panorama", 32, 16, radius=1.0), True, SHARED),
        pytest.param(SMALL["noncentral-spherical-mirror"], True, {}, marks=pytest.mark.soak),
    ],
)
def test_depth_of_a_source_that_is_not_exact_is_bounded(tmp_path, camera, whole, way):
    pose = Pose.from_angles((0.31237, -0.41713, 1.41391), 33.7, 25, 14)
    source = Inexact(omniscv.open_source("scene://four-wall?traces=0"), whole)
    with Recording(source, tmp_path / "room") as recording:
        image = omniscv.render(camera, pose, recording, MODES, **way)
    errors = Errors(image, mock_server.load_scene("four-wall"))
    assert not (image.valid & ~image.unsure & ~errors.label & (errors.depth_m > image.depth_error)).any()
    if whole:  # a quarter of a step is off in the median
        assert image.doubtful < 0.2
        assert np.median(image.depth_error[image.valid]) < 3.52 * 0.00025
    else:  # depth of another size is as inexact
        live = Inexact(omniscv.open_source("scene://four-wall?traces=0"), whole)
        compared = omniscv.render(camera, pose, live, MODES, checks="beat")
        assert np.median(compared.depth_error[image.valid]) < 1.5 * np.median(image.depth_error[image.valid])
    with omniscv.open_source(str(tmp_path / "room")) as replayed:
        again = omniscv.render(camera, pose, replayed, MODES, **way)
    assert (again.depth_error == image.depth_error).all()


CAMERAS = {
    "ball": lambda s: create(
        "noncentral-spherical-mirror", 32, 32, mirror_radius=0.3 * s, distance=0.3 * s, fov_deg=280
    ),
    "ring": lambda s: create("noncentral-panorama", 24, 12, radius=0.5 * s),
    "panorama": lambda s: create("equirectangular", 128, 64),
}
AT_SCALES = [("ball", {"strategy": "exact"}), ("ring", {"viewpoints": 4, "accuracy": 0.1}), ("panorama", {})]
POSE = Pose.from_angles((0.1, 0.2, 1.5), yaw_deg=10, pitch_deg=5, roll_deg=-7)


class Scaled(SourceWrapper):
    def __init__(self, source, scale):
        super().__init__(source)
        self.scale = scale

    def capture(self, requests):
        requests = list(requests)
        inner = [replace(each, view=moved(each.view, 1 / self.scale)) for each in requests]
        for request, capture in zip(requests, self._source.capture(inner), strict=True):
            pixels = capture.pixels
            if request.mode == "depth":
                pixels = np.float32(pixels.astype(np.float64) * self.scale)
            yield replace(capture, request=request, view=moved(capture.view, self.scale), pixels=pixels)


def moved(view, scale):
    return replace(view, pose=Pose(view.pose.t_w_c * scale, view.pose.R_w_c))


def made(name, way, scale):
    pose = Pose(POSE.t_w_c * scale, POSE.R_w_c)
    with omniscv.open_source("scene://six-wall?traces=0") as source:
        image = omniscv.render(CAMERAS[name](scale), pose, Scaled(source, scale), MODES, face_size=128, **way)
    metres = {layer: image[layer] / np.float32(scale) for layer in ("depth", "depth_error")}
    return replace(image, camera=CAMERAS[name](1), pose=POSE, layers={**image.layers, **metres})


@pytest.mark.parametrize(("name", "way"), AT_SCALES)
def test_marks_are_the_same_at_every_scale(name, way):
    """Of a room of 7 mm, of 7 m and of 7 km."""
    least, image, most = (made(name, way, scale) for scale in (1e-3, 1.0, 1e3))
    scene = mock_server.load_scene("six-wall")
    for other in (least, most):
        few = 0.006  # of 812 pixels five: depth of another scale is rounded elsewhere, also at bounds of 1 %
        assert abs(other.doubtful - image.doubtful) < few
        assert abs(other.label_edge.sum() - image.label_edge.sum()) < few * image.valid.sum()
        assert Errors(other, scene).uncovered.sum() <= 1


def test_a_centre_a_micrometre_off_a_wall():
    x = -3.0 + 1e-6
    (y, z) = np.random.default_rng(0).uniform((-1, 0.5), 2)
    camera = CAMERAS["panorama"](1)
    pose = Pose.from_angles((x, y, z), yaw_deg=40, pitch_deg=25)
    with omniscv.open_source("scene://six-wall?traces=0") as source:
        image = omniscv.render(camera, pose, source, MODES)
    assert not Errors(image, mock_server.load_scene("six-wall")).uncovered.any()
