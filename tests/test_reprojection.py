"""Pictures by another camera: judged by functions of the direction, which any camera may show."""

import cv2
import numpy as np
import pytest

import omniscv
from omniscv import Pose
from omniscv.cameras import create, model, names
from omniscv.cli import run
from omniscv.compose.files import read
from omniscv.dataset import media
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL
from omniscv.pictures.photo_sphere import read_photo_sphere
from omniscv.planning.densities import pixels_per_radian
from omniscv.reprojection import Reprojection

CENTRAL = sorted(name for name in names() if model(name).central and model(name).example(64).valid().any())
PANORAMA = create("equirectangular", width=512, height=256)
FISHEYE = create("fisheye-equidistant", width=128, height=128, fov_deg=185)
TURNED = R_LEVEL.T @ Pose.from_angles((0, 0, 0), 70, -25, 40).R_w_c


def wave(directions):
    """A smooth function on the sphere, of -1 to 1; its second derivative is at most 9."""
    return np.sin(3 * directions @ np.array([0.6, -0.48, 0.64]))


def shown(camera, function):
    """A picture (H, W) of a function of the direction, 0 where the camera has no ray."""
    rays = camera.unproject()
    return np.where(rays.valid, function(np.where(rays.valid[..., None], rays.directions, 1.0)), 0.0)


@pytest.mark.parametrize("name", CENTRAL)
def test_every_camera_shows_what_a_panorama_shows(name):
    camera = model(name).example(96)
    picture = shown(PANORAMA, wave).astype(np.float32)
    made = omniscv.reproject(picture, from_=PANORAMA, to=camera, rotation=TURNED, filter="bilinear")
    rays = camera.unproject()
    expected = wave(np.where(rays.valid[..., None], rays.directions, 1.0) @ TURNED.T)
    # Bilinear interpolation is off by an eighth of the second differences along both axes; at the poles,
    # beyond the middle of the first and the last row, by a slope of 3 over half a row.
    step = 2 * np.pi / PANORAMA.width
    off = np.abs(made - expected)[rays.valid]
    assert np.quantile(off, 0.995) < 2 * 9 * step**2 / 8 + 1e-4
    assert off.max() < 3 * step
    assert (made[~rays.valid] == 0).all()


@pytest.mark.parametrize("name", CENTRAL)
def test_a_picture_of_every_camera_becomes_a_panorama(name):
    """Where it looks: at the rim of a view a pixel is the nearest one, half a pixel and more away."""
    camera = model(name).example(192)
    small = create("equirectangular", width=128, height=64)
    picture = shown(camera, wave).astype(np.float32)
    made = omniscv.reproject(picture, from_=camera, to=small, filter="bilinear")
    seen = Reprojection(camera, small, np.eye(3)).valid
    directions = small.unproject().directions
    off = np.abs(made - wave(directions))[seen]
    step = 1 / pixels_per_radian(camera)
    # The slope is at most 3, and the coarsest pixels span four times as much as those of the finer half.
    assert off.max() < 3 * 4 * step
    assert np.quantile(off, 0.9) < 3 * step
    assert (made[~seen] == 0).all()
    assert seen[camera.project(directions)[1]].mean() > 0.95


def test_a_quarter_turn_of_a_panorama_shifts_its_columns():
    picture = np.random.default_rng(1).integers(0, 65536, (64, 128), dtype=np.uint16)
    small = create("equirectangular", width=128, height=64)
    rotation = R_LEVEL.T @ Pose.from_angles((0, 0, 0), 90).R_w_c
    made = omniscv.reproject(picture, from_=small, to=small, rotation=rotation, filter="nearest")
    np.testing.assert_array_equal(made, np.roll(picture, 32, axis=1))


def test_the_seam_of_a_panorama_is_blended():
    """A fisheye that looks backwards has the seam in its middle."""
    back = R_LEVEL.T @ Pose.from_angles((0, 0, 0), 180).R_w_c
    picture = shown(PANORAMA, wave).astype(np.float32)
    made = omniscv.reproject(picture, from_=PANORAMA, to=FISHEYE, rotation=back, filter="bilinear")
    steps = np.abs(np.diff(made[64]))
    assert steps[60:68].max() < 1.5 * np.median(steps[40:88]) + 0.01


@pytest.mark.parametrize("filter", ["area", "bilinear", "nearest"])
def test_faces_of_a_cube_are_not_mixed_in_the_picture(filter):
    """Each face has a value that no mean of others is: pixels have such, but along the cube's own edges."""
    cube = create("cube-map", width=192, height=128, layout="3x2")
    values = np.array([1, 2, 4, 8, 16, 32], np.float32)
    picture = np.kron(values.reshape(2, 3), np.ones((64, 64), np.float32))
    made = omniscv.reproject(picture, from_=cube, to=PANORAMA, filter=filter)
    mixed = ~np.isin(made, values)
    assert mixed.mean() < 0.06
    assert set(np.unique(made[~mixed])) == set(values)


def test_area_averages_light_and_not_codes():
    """A pixel spans black and white columns: half of the light is code 188 of sRGB."""
    picture = np.zeros((512, 1024, 3), np.uint8)
    picture[:, ::2] = 255
    fine = create("equirectangular", width=1024, height=512)
    coarse = create("equirectangular", width=128, height=64)
    made = omniscv.reproject(picture, from_=fine, to=coarse, transfer="srgb")
    codes = omniscv.reproject(picture, from_=fine, to=coarse)
    assert abs(float(np.median(made)) - 188) <= 2
    assert abs(float(np.median(codes)) - 127.5) <= 2


def test_labels_are_those_of_the_exact_scene():
    """But within a pixel of a border between two of them."""
    pose = Pose.from_angles((0.2, 0.1, 1.5), 20)
    with omniscv.open_source("scene://four-wall") as scene:
        panorama = omniscv.render(create("equirectangular", 1024, 512), pose, scene, ("object_mask",))
        fisheye = omniscv.render(FISHEYE, pose, scene, ("object_mask",))
    made = omniscv.reproject(panorama.labels, from_=panorama.camera, to=FISHEYE, filter="nearest")
    wrong = (made != fisheye.labels) & fisheye.valid
    assert wrong.mean() < 0.01
    assert not (wrong & ~fisheye["label_edge"]).any() or (wrong & ~fisheye["label_edge"]).mean() < 0.004


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"to": model("noncentral-panorama").example(32)}, "to: expected a camera with one optical centre"),
        ({"image": np.zeros((5, 5))}, "expected .* 512x256 px, as its camera has, got .* 5"),
        ({"image": np.zeros((256, 512), np.uint32)}, "expected pixels of uint8.*, got uint32"),
        ({"rotation": 2 * np.eye(3)}, "rotation: expected"),
        ({"filter": "cubic"}, "filter: expected"),
    ],
    ids=["several centres", "another size", "no type to blend", "no rotation", "no filter"],
)
def test_what_cannot_be_done_is_refused(arguments, expected):
    given = {"image": np.zeros((256, 512), np.uint8), "from_": PANORAMA, "to": FISHEYE, "filter": "bilinear"}
    given |= arguments
    with pytest.raises(ArgumentError, match=expected):
        omniscv.reproject(given.pop("image"), **given)


def test_a_folder_of_layers_by_the_command(tmp_path):
    with omniscv.open_source("scene://four-wall") as scene:
        camera = create("equirectangular", 256, 128)
        image = omniscv.render(camera, Pose.from_angles((0, 0, 1.5)), scene, ("lit", "object_mask", "depth"))
    image.save(tmp_path / "in", "room")
    options = ["--camera", "pinhole", "--size", "64x48", "--set", "fov_deg=90", "--yaw", "0,90"]
    assert run(["reproject", str(tmp_path / "in"), str(tmp_path / "out"), *options]) == 0
    depth = read(tmp_path / "out" / "room_yaw90.depth.exr", "depth")
    assert depth.shape == (48, 64)
    stored = read(tmp_path / "in" / "room.depth.exr", "depth")
    assert np.isin(depth, stored).all()
    before = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert "room_yaw0.lit.png" in before
    assert "room_yaw0.labels.png" in before
    assert run(["reproject", str(tmp_path / "in"), str(tmp_path / "out"), *options]) == 2  # files are there
    assert run(["reproject", str(tmp_path / "in"), str(tmp_path / "out"), *options, "--overwrite"]) == 0


def test_pictures_are_not_replaced_by_what_is_made_of_them(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((16, 32, 3), 9, np.uint8))
    before = (tmp_path / "a.png").read_bytes()
    options = ["--camera", "pinhole", "--size", "8x8", "--set", "fov_deg=90", "--overwrite"]
    for source in (tmp_path, tmp_path / "a.png"):
        assert run(["reproject", str(source), str(tmp_path), *options]) == 2
        assert "expected another folder than that of the pictures" in capsys.readouterr().err
    assert (tmp_path / "a.png").read_bytes() == before


def test_nothing_is_written_where_one_of_several_files_is_there(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / "in" / name), np.full((16, 32, 3), 9, np.uint8))
    (tmp_path / "out" / "b.png").write_text("mine")
    options = ["--camera", "pinhole", "--size", "8x8", "--set", "fov_deg=90"]
    assert run(["reproject", str(tmp_path / "in"), str(tmp_path / "out"), *options]) == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["b.png"]
    assert (tmp_path / "out" / "b.png").read_text() == "mine"


@pytest.mark.parametrize(
    ("shape", "options", "expected"),
    [
        ((10, 30, 3), (), "expected a panorama of 2:1, got 30x10"),
        ((10, 20, 3), ("--set", "fov_deg=400"), "fov_deg: expected"),
    ],
    ids=["no panorama", "no field of view"],
)
def test_the_command_refuses_in_one_line(tmp_path, capsys, shape, options, expected):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros(shape, np.uint8))
    camera = ["--camera", "fisheye-equidistant", "--size", "64x64", *options]
    assert run(["reproject", str(tmp_path / "a.png"), str(tmp_path / "out"), *camera]) == 2
    assert expected in capsys.readouterr().err


def test_a_folder_that_is_not_there_is_refused(tmp_path, capsys):
    camera = ["--camera", "fisheye-equidistant", "--size", "64x64"]
    assert run(["reproject", str(tmp_path / "none"), str(tmp_path / "out"), *camera]) == 2
    assert "IN: expected a picture or a folder of pictures, got none at" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def cropped(picture, left, top, width, height, **fields):
    """The bytes of a JPEG that shows a part of a panorama, as a phone writes them."""
    whole_height, whole_width = picture.shape[:2]
    columns = (left + np.arange(width)) % whole_width
    part = np.ascontiguousarray(picture[top : top + height, columns, ::-1])
    encoded = cv2.imencode(".png", part)[1].tobytes()
    described = {
        "ProjectionType": "equirectangular",
        "CroppedAreaLeftPixels": left, "CroppedAreaTopPixels": top,
        "CroppedAreaImageWidthPixels": width, "CroppedAreaImageHeightPixels": height,
        "FullPanoWidthPixels": whole_width, "FullPanoHeightPixels": whole_height, **fields,
    }  # fmt: skip
    return media.with_photo_sphere(encoded, {name: str(value) for name, value in described.items()})


@pytest.mark.parametrize("left", [20, 100], ids=["in the middle", "across the seam"])
def test_a_part_of_a_sphere_is_where_its_data_say(tmp_path, left):
    panorama = create("equirectangular", width=128, height=64)
    whole = np.round(127 + 100 * shown(panorama, wave)).astype(np.uint8)[..., None].repeat(3, axis=-1)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.png").write_bytes(cropped(whole, left, 10, 60, 30))
    command = ["reproject", str(tmp_path / "in"), str(tmp_path / "out"), "--camera", "equirectangular"]
    assert run([*command, "--size", "128x64"]) == 0
    made = cv2.imread(str(tmp_path / "out" / "a.png"))[..., ::-1]
    columns = (left + np.arange(60)) % 128
    np.testing.assert_array_equal(made[10:40][:, columns], whole[10:40][:, columns])
    assert made.any(axis=-1).sum() <= 60 * 30


def test_a_panorama_that_is_made_says_how_its_camera_was_held(tmp_path):
    whole = np.full((32, 64, 3), 99, np.uint8)
    tags = {"PoseHeadingDegrees": 30, "PosePitchDegrees": 0, "PoseRollDegrees": 0}
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "held.png").write_bytes(cropped(whole, 0, 0, 64, 32, **tags))
    cv2.imwrite(str(tmp_path / "in" / "plain.jpg"), whole)
    command = ["reproject", str(tmp_path / "in"), str(tmp_path / "out"), "--camera", "equirectangular"]
    assert run([*command, "--size", "64x32", "--yaw", "20"]) == 0
    held = read_photo_sphere(tmp_path / "out" / "held.png")
    assert held.heading_deg == pytest.approx(10)  # clockwise; the new camera looks to the left
    plain = read_photo_sphere(tmp_path / "out" / "plain.jpg")
    assert plain.heading_deg is None
    assert (plain.is_cropped, plain.pitch_deg) == (False, 0)
