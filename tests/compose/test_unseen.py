"""Images from whatever views a recording holds at a centre; the exact tracer judges."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from PIL import Image
from support.judged import Errors

import mock_server
import omniscv
from omniscv import dataset, job, make
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Pose
from omniscv.sources.base import Request, View
from omniscv.sources.requests import Lens
from omniscv.sources.scene import SceneSource

MODES = ("lit", "object_mask", "depth")
AT = (0.1, -0.2, 1.5)
POSE = Pose.from_angles(AT, yaw_deg=20, pitch_deg=7, roll_deg=3)
ONE_PICTURE = [View(POSE, 90.0, 640, 480)]


def pictures(seed, number):
    """Views at one centre of any size, field of view and orientation, some with another principal point."""
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(number):
        pose = Pose.from_angles(AT, *rng.uniform(-80, 80, 2), rng.uniform(-180, 180))
        fov = float(rng.uniform(40, 110))
        size = map(int, rng.integers(150, 500, 2))
        views.append(View(pose, fov, *size, lens=(None, Lens(1.1, 0.08, -0.05))[int(rng.integers(2))]))
    return views


@pytest.fixture
def recording(tmp_path):
    """Records views of the furnished room, ``{mode: views}`` or the same in all modes."""
    counter = count()

    def make(views):
        views_of = views if isinstance(views, dict) else dict.fromkeys(MODES, views)
        path = tmp_path / f"few-{next(counter)}.sqlite"
        scene = SceneSource(mock_server.load_scene("four-wall"))
        with omniscv.record(scene, path) as source:
            for mode, these in views_of.items():
                list(source.capture([Request(view, mode) for view in these]))
        return path

    return make


def fisheye(fov_deg, size=120):
    return omniscv.cameras.create("fisheye-equidistant", width=size, height=size, fov_deg=fov_deg)


def render(path, camera, **options):
    with omniscv.open_source(str(path)) as source:
        return omniscv.render(camera, POSE, source, MODES, **options)


def wrong(image):
    """The share of valid pixels whose depth, or label, is wrong and not marked."""
    return Errors(image, mock_server.load_scene("four-wall")).uncovered[image.valid].mean()


def seen(views, camera):
    """(H, W) whether a ray passes through one of the pictures, by similar triangles."""
    rays_w = camera.unproject().directions @ POSE.R_w_c.T
    inside = np.zeros(rays_w.shape[:2], bool)
    for view in views:
        x, y, z = np.moveaxis(rays_w @ view.pose.R_w_c, -1, 0)
        squeeze, right, below = view.lens or Lens()
        half = np.tan(np.radians(view.fov_deg / 2))  # of the width, in tangents
        u, v = x / z / half + 2 * right, squeeze * y / z / half * view.width / view.height + 2 * below
        inside |= (z > 0) & (np.abs(u) <= 1) & (np.abs(v) <= 1)
    return inside & camera.valid()


def test_one_picture_serves_an_image_inside_it_and_others_are_refused_in_one_line(recording):
    path = recording(ONE_PICTURE)
    image = render(path, fisheye(60))
    assert image.valid[fisheye(60).valid()].all()
    assert (wrong(image), image.unseen) == (0, 0)
    share = 1 - seen(ONE_PICTURE, fisheye(180)).sum() / fisheye(180).valid().sum()
    expected = rf"recorded views at .* {100 * share:.3g} % are seen by none; render with unseen='blank'"
    with pytest.raises(MissingCaptureError, match=expected):
        render(path, fisheye(180))
    behind = replace(POSE, rotation=POSE.R_w_c @ np.diag([-1.0, 1, -1]))
    with pytest.raises(MissingCaptureError, match="100 % are seen by none"):
        render(recording([View(behind, 30.0, 64, 64)]), fisheye(60), unseen="blank")


@pytest.mark.parametrize("seed", range(2))
def test_any_pictures_at_a_centre_serve_what_they_see(recording, seed):
    views = pictures(seed, 5)
    camera = fisheye(200)
    image = render(recording(views), camera, unseen="blank")
    np.testing.assert_array_equal(image.valid, seen(views, camera))
    assert image.unseen == pytest.approx(1 - image.valid.sum() / camera.valid().sum())
    for name in ("lit", "object_mask", "labels", "depth", "depth_error"):
        assert not image[name][~image.valid].any()
    assert wrong(image) <= 5e-4  # as everywhere: what one sampling cannot see


def test_the_finest_picture_serves_a_ray(recording):
    """A coarse picture of everything in sight, recorded first, and a fine one in its middle."""
    coarse = View(POSE, 100.0, 80, 80)
    fine = View(POSE, 40.0, 400, 400)
    both = render(recording([coarse, fine]), fisheye(60))
    alone = {view: render(recording([view]), fisheye(60), unseen="blank") for view in (coarse, fine)}
    middle = np.s_[30:90, 30:90]
    inside = (alone[fine].valid & ~alone[fine].unsure)[middle]
    np.testing.assert_array_equal(both.lit[middle][inside], alone[fine].lit[middle][inside])
    outside = ~alone[fine].valid & both.valid
    np.testing.assert_array_equal(both.depth[outside], alone[coarse].depth[outside])


def test_depth_may_have_pictures_of_its_own(recording):
    """As sensors whose depth is coarser than their colours: a pixel is valid where both see it."""
    depth = View(POSE, 70.0, 160, 120)
    path = recording({"lit": ONE_PICTURE, "object_mask": ONE_PICTURE, "depth": [depth]})
    image = render(path, fisheye(120), unseen="blank")
    np.testing.assert_array_equal(image.valid, seen([depth], fisheye(120)))
    assert wrong(image) <= 5e-4


def test_a_place_may_be_a_millimetre_away(recording):
    path = recording(ONE_PICTURE)
    with omniscv.open_source(str(path)) as source:
        near = replace(POSE, position=np.add(AT, (0, 0.0009, 0)))
        image = omniscv.render(fisheye(60), near, source, ("depth",))
        np.testing.assert_array_equal(image.centers_w, AT)
        with pytest.raises(MissingCaptureError, match=r"recorded view differs in position by 0\.0011"):
            omniscv.render(fisheye(60), replace(POSE, position=np.add(AT, (0, 0.0011, 0))), source)


def test_datasets_and_exports_treat_unseen_pixels_as_outside(recording, tmp_path):
    path = recording(ONE_PICTURE)
    poses = [{"position": list(AT), "yaw_deg": 20, "pitch_deg": 7, "roll_deg": 3}]
    eye = {"cameras": {"eye": fisheye(150).to_dict()}, "poses": poses, "modes": list(MODES)}
    make.make(job.load({"source": str(path), **eye, "unseen": "blank", "out": str(tmp_path / "set")}))
    (frame,) = dataset.open(tmp_path / "set")
    np.testing.assert_array_equal(frame.valid, seen(ONE_PICTURE, frame.camera))
    assert dataset.check(tmp_path / "set", deep=True) == []
    dataset.export(tmp_path / "set", "nerfstudio")
    (mask,) = (tmp_path / "set").rglob(f"masks/{frame.key}.png")
    np.testing.assert_array_equal(np.asarray(Image.open(mask)) > 0, frame.valid)
