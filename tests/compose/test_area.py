"""``area`` shows the mean of what a pixel spans: that of 8 x 8 rays in it, each traced exactly."""

from functools import cache

import numpy as np
import pytest
from support.exact import float_source

import omniscv
from mock_server.scene import Scene
from omniscv.cameras import create
from omniscv.geometry import Pose

POSE = Pose.from_angles((0.1, 0, 1.5), yaw_deg=15.0, pitch_deg=20.0, roll_deg=10.0)
CAMERAS = {
    "equirectangular": create("equirectangular", width=128, height=64),
    "fisheye-equidistant": create("fisheye-equidistant", width=96, height=96, fov_deg=180),
}
PIXEL = {"equirectangular": 2 * np.pi / 128, "fisheye-equidistant": np.pi / 96}
NONCENTRAL = create("noncentral-panorama", width=32, height=16, radius=0.5)
SUBRAYS = 8


@cache
def waves(period_rad):
    return Scene("waves", {"pattern": {"kind": "waves", "period_rad": period_rad}})


def checkers(name, edge, **solid):
    texture = {"kind": "checker", "colors": [[0.9, 0.9, 0.85], [0.2, 0.25, 0.3]], "scale": edge}
    return Scene(name, {"sky": [0.5, 0.6, 0.7], "objects": {name: {"texture": texture, "solids": [solid]}}})


CHECKERBOARD = checkers("Hall", 1.0, sphere=3.0, at=[0, 0, 1.5])


@cache
def means(scene, camera, subrays=SUBRAYS):
    """(H, W, 3) colours: the mean of the valid ones of a pixel's rays."""
    at = (np.arange(subrays) + 0.5) / subrays - 0.5
    total, count = np.zeros((camera.height, camera.width, 3)), 0
    for offset in np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2):
        rays = camera.unproject(camera.pixels() + offset)
        inside = rays.valid[..., None]
        origins = POSE.position if camera.central else POSE.to_world(np.where(inside, rays.origins, 0))
        rays_w = np.where(inside, rays.directions, (0, 0, 1)) @ POSE.R_w_c.T
        total += inside * scene.trace(origins, rays_w).color
        count = count + inside
    return total / np.maximum(count, 1)


source_of = cache(float_source)


def shown(scene, camera, face_size, filter="area", **options):
    return omniscv.render(camera, POSE, source_of(scene), filter=filter, face_size=face_size, **options)


def rms(image, wanted, where=True):
    """Grey levels of 255."""
    return 255 * np.sqrt(((image.lit - wanted)[image.valid & where] ** 2).mean())


def kept(values, scene, camera):
    """The share of a sinusoid's height that pixels keep, where it is crossed at its own period."""
    rays = camera.unproject()
    directions = np.where(rays.valid[..., None], rays.directions, 0)
    rays_w = directions @ POSE.R_w_c.T
    some = rays.valid[..., None] & (np.abs(rays_w) < 0.3) & (np.abs(directions[..., 1:2]) < 0.3)
    wave = scene.trace((0, 0, 0), rays_w).color[some] - 0.5
    return ((values[some] - 0.5) * wave).sum() / (wave**2).sum()


@pytest.mark.parametrize(
    ("name", "period_px", "face_size"),
    [("equirectangular", 2.5, 160), ("fisheye-equidistant", 2.5, 384), ("fisheye-equidistant", 4.0, 120)],
)
def test_sinusoids_keep_what_the_mean_keeps(name, period_px, face_size):
    """.77 and .91 of their height."""
    camera, scene = CAMERAS[name], waves(period_px * PIXEL[name])
    image, wanted = shown(scene, camera, face_size), means(scene, camera)
    assert abs(kept(image.lit, scene, camera) - kept(wanted, scene, camera)) <= 0.01
    assert rms(image, wanted) <= 2


def test_an_image_as_fine_as_its_faces_keeps_as_much():
    """At automatic size interpolation takes what the mean would, and nothing is left to average."""
    camera, scene = CAMERAS["equirectangular"], waves(2.5 * PIXEL["equirectangular"])
    image, wanted = shown(scene, camera, "auto"), means(scene, camera)
    assert abs(kept(image.lit, scene, camera) - kept(wanted, scene, camera)) <= 0.05


@pytest.mark.parametrize(("name", "period_px"), [*zip(CAMERAS, [0.7, 0.9], strict=True)])
def test_sinusoids_shorter_than_a_pixel_keep_no_more_than_the_mean_keeps(name, period_px):
    """A bilinear image shows others in their place, that are not there."""
    camera, scene = CAMERAS[name], waves(period_px * PIXEL[name])
    wanted = means(scene, camera)
    image, bilinear = (shown(scene, camera, 384, filter) for filter in ("area", "bilinear"))
    assert abs(kept(image.lit, scene, camera)) <= abs(kept(wanted, scene, camera)) + 0.05
    assert rms(image, wanted) < 0.12 * rms(bilinear, wanted)


@pytest.mark.parametrize("fov_deg", [pytest.param(180, marks=pytest.mark.soak), 300])
def test_at_the_rim_only_what_is_inside_the_field_of_view_counts(fov_deg):
    camera = create("fisheye-equidistant", width=96, height=96, fov_deg=fov_deg)
    scene = waves(3 * np.radians(fov_deg) / 96)
    image = shown(scene, camera, 384)
    assert (image.lit[~image.valid] == 0).all()
    rim = np.hypot(*(np.indices((96, 96)) - 47.5)) > 46.5
    assert (image.valid & rim).sum() > 200
    assert rms(image, means(scene, camera), rim) <= 4


@pytest.mark.parametrize("strategy", ["cube", "exact"])
def test_pixels_of_a_viewpoint_are_averaged_too(strategy):
    """A strip is as wide as the footprints of its rays."""
    scene = waves(3 * np.pi / 16)
    image, wanted = shown(scene, NONCENTRAL, 128, strategy=strategy), means(scene, NONCENTRAL)
    assert rms(image, wanted) <= 2


def test_what_depth_marching_finds_is_averaged_over_the_step_of_a_pixel():
    """Its rays are not the pixels' own, and have no neighbours: their footprints are squares."""
    wanted = means(CHECKERBOARD, NONCENTRAL)
    area, bilinear = (shown(CHECKERBOARD, NONCENTRAL, 128, filter) for filter in ("area", "bilinear"))
    assert rms(area, wanted) < 0.3 * rms(bilinear, wanted)


def test_auto_averages_where_the_image_is_coarser():
    camera, scene = CAMERAS["equirectangular"], waves(3 * PIXEL["equirectangular"])
    area, auto, bilinear = (shown(scene, camera, 384, filter).lit for filter in ("area", "auto", "bilinear"))
    assert np.array_equal(area, auto)
    assert not np.array_equal(area, bilinear)


def test_one_view_is_averaged_as_faces_are():
    camera = create("pinhole", width=48, height=32, fov_deg=60)
    scene = waves(np.radians(60) / 16)
    image = shown(scene, camera, 640)
    assert rms(image, means(scene, camera)) <= 2
