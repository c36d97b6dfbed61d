"""Photo spheres act, and pictures that have the shape of a panorama or a cube and are none are named."""

from itertools import product

import numpy as np
import pytest
from PIL import Image
from support.pictured import SMALL, put, run
from support.spherical import AT, Painted, faces, flat, panorama, two_eyes, two_fisheyes

import omniscv
from omniscv.dataset.media import photo_sphere_fields, with_photo_sphere
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.importing.importing import import_pictures
from omniscv.pictures.photo_sphere import read_photo_sphere

HEIGHT = 128
WORLD = Painted(3)
POSE = Pose.from_angles(AT, 25, -12, 8)
LEVEL = Pose.from_angles(AT)
AXES = LEVEL.R_w_c.T  # of a panorama's rays, X ahead: to the camera's


def sphere_fields(**changed):
    camera = omniscv.cameras.create("equirectangular", 2 * HEIGHT, HEIGHT)
    return {**photo_sphere_fields(camera, POSE), **changed}


def written(path, pixels, fields):
    put(path, pixels)
    path.write_bytes(with_photo_sphere(path.read_bytes(), fields))
    return path


def off(recording, pose=LEVEL):
    """Grey levels by which an image of a recording differs from the world, and its mask of what is shown."""
    with omniscv.open_source(recording) as source:
        image = omniscv.render(SMALL, pose, source, ("lit",))
    expected = panorama(WORLD, SMALL.height, R=pose.R_w_c @ AXES)
    return np.abs(image.lit.astype(float) - expected).mean(axis=-1)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_photo_sphere_of_a_tilted_camera_is_turned_back(suffix, tmp_path):
    pixels = panorama(WORLD, HEIGHT, R=POSE.R_w_c @ AXES)
    file = written(tmp_path / f"a.{suffix}", pixels, sphere_fields())
    found = import_pictures(file, tmp_path / "a.sqlite", position=AT)
    assert any("1 pictures turned as they say they were held" in line for line in found.lines)
    assert off(tmp_path / "a.sqlite").mean() < 9  # 40 if the tilt is ignored
    np.testing.assert_allclose(read_photo_sphere(file).angles_deg, (25 - 360, -12, 8))


def test_what_the_user_says_comes_before_the_heading(tmp_path):
    pose = Pose.from_angles(AT, 0, -12, 8)
    pixels = panorama(WORLD, HEIGHT, R=pose.R_w_c @ AXES)
    file = written(tmp_path / "a.png", pixels, sphere_fields())
    found = import_pictures(file, tmp_path / "a.sqlite", position=AT, yaw_deg=0.0)
    assert any("--yaw comes before their heading" in line for line in found.lines)
    assert off(tmp_path / "a.sqlite").mean() < 9
    (tmp_path / "poses.csv").write_text("name,x,y,z,yaw_deg\na,0.2,-0.1,1.4,0\n")
    level = written(tmp_path / "a.png", panorama(WORLD, HEIGHT), sphere_fields())
    found = import_pictures(level, tmp_path / "b.sqlite", poses=tmp_path / "poses.csv")
    assert any("--poses comes first" in line for line in found.lines)
    assert off(tmp_path / "b.sqlite").mean() < 9


CROPS = {
    "180 x 90 degrees": (HEIGHT // 2, HEIGHT // 4, HEIGHT, HEIGHT // 2),
    "360 x 90 degrees": (0, HEIGHT // 4, 2 * HEIGHT, HEIGHT // 2),
}


@pytest.mark.parametrize("crop", CROPS.values(), ids=CROPS)
def test_a_crop_stays_where_it_is_on_the_sphere(crop, tmp_path):
    left, top, width, height = crop
    part = (
        left / HEIGHT - 1,
        (left + width) / HEIGHT - 1,
        2 * top / HEIGHT - 1,
        2 * (top + height) / HEIGHT - 1,
    )
    pixels = panorama(WORLD, height, part=part, width=width)
    cropped = {
        "CroppedAreaLeftPixels": str(left),
        "CroppedAreaTopPixels": str(top),
        "CroppedAreaImageWidthPixels": str(width),
        "CroppedAreaImageHeightPixels": str(height),
        "PoseHeadingDegrees": "0",
        "PosePitchDegrees": "0",
        "PoseRollDegrees": "0",
    }
    file = written(tmp_path / "a.png", pixels, sphere_fields(**cropped))
    found = import_pictures(file, tmp_path / "a.sqlite", position=AT)
    assert any("elsewhere they are black" in line for line in found.lines)
    difference = off(tmp_path / "a.sqlite")
    rows = slice(SMALL.height * top // HEIGHT + 2, SMALL.height * (top + height) // HEIGHT - 2)
    columns = slice(SMALL.width * left // 2 // HEIGHT + 2, SMALL.width * (left + width) // 2 // HEIGHT - 2)
    assert difference[rows, columns].mean() < 9
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        image = omniscv.render(SMALL, LEVEL, source, ("lit",))
    assert not image.lit[: rows.start - 4].any()


REFUSED = {
    "two eyes": (
        {"StereoMode": "top-bottom"},
        "StereoMode: expected mono, got 'top-bottom'; cut",
    ),
    "a cylinder": ({"ProjectionType": "cylindrical"}, "ProjectionType: expected equirectangular, got 'cylin"),
    "a crop beyond": ({"CroppedAreaTopPixels": "10"}, "CroppedAreaLeftPixels: expected a crop within"),
    "no 2:1": ({"FullPanoWidthPixels": "300"}, "FullPanoWidthPixels: expected twice the height"),
    "no number": ({"PosePitchDegrees": "up"}, "PosePitchDegrees: expected a finite number"),
}


@pytest.mark.parametrize(("fields", "says"), REFUSED.values(), ids=REFUSED)
def test_photo_spheres_that_are_none_are_refused_by_name(fields, says, tmp_path, capsys):
    file = written(tmp_path / "a.png", panorama(WORLD, 32), sphere_fields(**fields))
    assert run(file, tmp_path / "a.sqlite") == 2
    assert says in capsys.readouterr().err


def test_elements_entities_and_other_prefixes_of_xmp(tmp_path):
    put(tmp_path / "a.jpg", panorama(WORLD, 32))
    packet = (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description xmlns:g="http://ns.google.com/photos/1.0/panorama/">'
        b"<g:PosePitchDegrees>7.5</g:PosePitchDegrees></rdf:Description></x:xmpmeta>"
    )
    content = (tmp_path / "a.jpg").read_bytes()
    xmp = b"http://ns.adobe.com/xap/1.0/\0" + packet
    segment = b"\xff\xe1" + (len(xmp) + 2).to_bytes(2, "big") + xmp
    (tmp_path / "a.jpg").write_bytes(content[:2] + segment + content[2:])
    assert read_photo_sphere(tmp_path / "a.jpg").pitch_deg == 7.5
    put(tmp_path / "b.jpg", panorama(WORLD, 32))
    assert read_photo_sphere(tmp_path / "b.jpg") is None


KINDS = ("boxes", "mesh", "mujoco")
SOAKED = [pytest.param(kind, marks=pytest.mark.soak) for kind in KINDS]
NO_PANORAMAS = {
    "two fisheyes": (two_fisheyes, "two fisheyes in black corners"),
    "eyes side by side": (two_eyes, "halves side by side that repeat"),
    "one eye above the other": (lambda world, height: two_eyes(world, height, True), "one above the other"),
    "a plain lens": (flat, "many points in the rows at the poles"),
}


@pytest.mark.parametrize("kind", [KINDS[0], *SOAKED[1:]])
@pytest.mark.parametrize(("drawn", "says"), NO_PANORAMAS.values(), ids=NO_PANORAMAS)
def test_what_is_twice_as_wide_as_high_and_no_panorama_is_named(drawn, says, kind, tmp_path, capsys):
    put(tmp_path / "a.png", drawn(Painted(1, kind), 256))
    assert run(tmp_path / "a.png", tmp_path / "a.sqlite") == 2
    message = capsys.readouterr().err
    assert says in message
    assert "--trust-words" in message
    if drawn is flat:
        assert run(tmp_path / "a.png", tmp_path / "a.sqlite", "--trust-words") == 0


NO_CUBES = {
    "equi-angular": ({"is_equi_angular": True}, "an equi-angular cube (EAC)"),
    "101 %": ({"extent": 1.01}, "got 90.57 degrees by their edges"),
    "104 %": ({"extent": 1.04}, "got 92.25 degrees by their edges"),
}


@pytest.mark.parametrize("kind", [KINDS[0], *SOAKED[1:]])
@pytest.mark.parametrize(("drawn", "says"), NO_CUBES.values(), ids=NO_CUBES)
def test_faces_that_are_not_flat_or_not_of_90_degrees_are_named(drawn, says, kind, tmp_path, capsys):
    for word, pixels in faces(Painted(2, kind), 256, **drawn).items():
        put(tmp_path / f"sky/{word}.png", pixels)
    assert run(tmp_path / "sky", tmp_path / "a.sqlite") == 2
    assert says in capsys.readouterr().err


def test_a_video_is_refused_with_what_takes_pictures_out_of_it(tmp_path):
    (tmp_path / "clip.mp4").write_bytes(b"\0\0\0\x18ftypmp42")
    for path in (tmp_path, tmp_path / "clip.mp4"):
        with pytest.raises(ArgumentError, match=r"got a video, 'clip\.mp4'; ffmpeg -i clip\.mp4 -vf"):
            import_pictures(path, tmp_path / "a.sqlite")


LOOKS = {
    "day": {},
    "plain walls": {"waves": 0.0},
    "dark": {"light": 0.06},
    "night": {"light": 0.01},
    "faint": {"waves": 4.0},
}


def spoilt(pixels, random, with_cap):
    """A panorama with noise, and over its tripod a picture that knows nothing of the sphere."""
    pixels = np.clip(pixels + random.normal(0, 2, pixels.shape), 0, 255).astype(np.uint8)
    if with_cap:
        rows = pixels.shape[0] // 10
        cap = random.integers(0, 255, (1, 12, 3), np.uint8)
        pixels[-rows:] = np.asarray(Image.fromarray(cap).resize((pixels.shape[1], rows)))
    return pixels


SOUND = [("boxes", 0, "day"), ("boxes", 0, "dark")]
FURTHER = [case for case in product(KINDS, range(4), LOOKS) if case not in SOUND]


@pytest.mark.parametrize(
    ("kind", "seed", "look"), [*SOUND, *(pytest.param(*case, marks=pytest.mark.soak) for case in FURTHER)]
)
def test_sound_panoramas_and_cubes_are_taken(kind, seed, look, tmp_path):
    """60 of both in all."""
    random = np.random.default_rng(seed)
    world = Painted(10 + seed, kind, **LOOKS[look])
    put(tmp_path / "a.png", spoilt(panorama(world, 128), random, with_cap=look == "day"))
    import_pictures(tmp_path / "a.png", tmp_path / "a.sqlite")
    for word, picture in faces(world, 192).items():
        put(tmp_path / f"sky/{word}.png", spoilt(picture, random, with_cap=False))
    import_pictures(tmp_path / "sky", tmp_path / "b.sqlite", "faces")
