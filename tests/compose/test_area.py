"""Where the image is coarser than the faces, what a pixel spans is averaged, and nothing is passed over."""

import numpy as np
from support.exact import float_source

import omniscv
from mock_server.scene import Scene
from omniscv.cameras import create
from omniscv.geometry import Pose
from omniscv.sources.scene import SceneSource

POSE = Pose.from_angles((0, 0, 0), yaw_deg=15.0, pitch_deg=20.0, roll_deg=10.0)
SMALL = create("equirectangular", width=256, height=128)
PIXEL = 2 * np.pi / 256


def waves(period_rad):
    return Scene("waves", {"pattern": {"kind": "waves", "period_rad": period_rad}})


SOURCES = {}


def error_of(filter, camera, period_rad, face_size):
    """(H, W, 3) how far the image is from the mean, in amplitudes, and the local period in pixels."""
    source = SOURCES.setdefault(period_rad, float_source(waves(period_rad)))
    image = omniscv.render(camera, POSE, source, filter=filter, face_size=face_size)
    rays_w = camera.unproject().directions @ POSE.R_w_c.T
    # sin(2 pi d_k / period): along the sphere d_k changes by sqrt(1 - d_k^2) a radian
    with np.errstate(divide="ignore", invalid="ignore"):
        local = period_rad / np.sqrt(1 - rays_w**2) / PIXEL
    return np.abs(image.lit - 0.5) / 0.47, local, image.valid


def test_waves_finer_than_a_pixel_become_their_mean():
    """2048 px faces as 256 x 128: 25 px of a face in a pixel each way; a bilinear image shows moire.

    ``auto`` takes ``area`` here by itself.
    """
    period = 0.5 * PIXEL
    error, local, _ = error_of("auto", SMALL, period, 2048)
    fine = local < 0.7  # nearer to a wave's own axis it is long, and rightly shown
    assert fine.mean() > 0.4
    assert error[fine].max() <= 0.02
    poles = np.zeros(fine.shape, dtype=bool)
    poles[:4] = poles[-4:] = True
    assert (fine & poles).any()
    moire, *_ = error_of("bilinear", SMALL, period, 2048)
    assert np.quantile(moire[fine], 0.9) > 0.8


def test_a_hemisphere_fades_evenly_to_its_rim():
    """At the image circle's rim only rays inside count: no darkening, no ringing."""
    camera = create("fisheye-equidistant", width=128, height=128, fov_deg=180)
    period = 0.5 * np.radians(180 / 128)
    image = omniscv.render(camera, POSE, float_source(waves(period)), filter="area", face_size=1024)
    assert np.abs(image.lit[image.valid].mean(axis=0) - 0.5).max() < 0.01
    rim = image.valid & (np.hypot(*(np.indices((128, 128)) - 63.5)) > 61.5)
    assert image.lit[rim].min() > 0.3
    assert (image.lit[~image.valid] == 0).all()


def test_a_plain_room_stays_plain():
    """Averages of one colour are that colour, in 8 bits as well: weights sum to one everywhere."""
    scene = Scene("grey", {"sky": [200 / 255, 100 / 255, 50 / 255]})
    for name, size in (("equirectangular", {}), ("fisheye-equidistant", {"fov_deg": 200})):
        camera = create(name, width=64, height=64, **size)
        image = omniscv.render(camera, POSE, SceneSource(scene), filter="area", face_size=256)
        assert (image.lit[image.valid] == (200, 100, 50)).all()


def test_where_nothing_is_minified_area_is_as_sharp_as_it_may_be():
    """Waves of eight pixels keep 70 % of their height: cos^4(pi / 16) of the average, and the faces' own."""
    camera = create("equirectangular", width=512, height=256)
    image = omniscv.render(camera, POSE, float_source(waves(8 * 2 * np.pi / 512)), filter="area")
    assert image.lit.max() - image.lit.min() > 0.7 * 2 * 0.47
    assert omniscv.render(camera, POSE, float_source(waves(0.2))).lit.shape == (256, 512, 3)
