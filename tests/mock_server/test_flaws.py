"""Faults of captures that have a strength: each against what it must give, over a socket."""

import io

import cv2
import numpy as np
import pytest

LIT, DEPTH, MASK = (f"vget /camera/0/{mode}" for mode in ("lit png", "depth npy", "object_mask png"))
EDGE = 32


@pytest.fixture
def picture(start, open_raw):
    """What a server with faults shows, after some commands."""

    def seen(command, *faults, after=(), depth="float32"):
        client = open_raw(start("four-wall", faults=faults, size=(EDGE, EDGE), depth=depth, seed=3))
        for each in after:
            assert client.text(each) == "ok"
        client.text("vget /unrealcv/version")  # cameras follow a tick later
        replies = [client.ask(command) for _ in range(2)]
        if command == DEPTH:
            return [np.load(io.BytesIO(reply), allow_pickle=False) for reply in replies]
        return [
            cv2.imdecode(np.frombuffer(reply, np.uint8), cv2.IMREAD_COLOR).astype(int) for reply in replies
        ]

    return seen


def at(x=0.0, pitch=0.0, yaw=0.0):
    return f"vset /camera/0/location {x} 0 150", f"vset /camera/0/rotation {pitch} {yaw} 0"


@pytest.mark.parametrize(
    ("fault", "asked", "shown"),
    [
        ("turned=10", at(pitch=60), at(pitch=60, yaw=10)),
        ("turned=10", at(pitch=30), at(pitch=30)),
        ("far-origin=100", at(x=50.4), at(x=50)),  # float32 has steps of 1 cm there
        ("far-origin=0.001", at(x=50.4), at(x=50.4)),
    ],
)
def test_a_wrong_pose_shows_what_is_there(picture, fault, asked, shown):
    one, other = picture(DEPTH, fault, after=asked)[0], picture(DEPTH, after=shown)[0]
    np.testing.assert_allclose(one, other, rtol=1e-5)  # locations come back from single precision


def test_jitter_moves_every_image_by_less_than_its_strength(picture):
    one, other = picture(DEPTH, "jitter=0.5")
    (sound, _) = picture(DEPTH)
    assert (one != other).any()
    widest = [cv2.dilate(np.log(sound), np.ones((3, 3))), cv2.erode(np.log(sound), np.ones((3, 3)))]
    inner = np.s_[2:-2, 2:-2]
    near = ((np.log(one) <= widest[0] + 0.02) & (np.log(one) >= widest[1] - 0.02))[inner]
    assert near.mean() > 0.95  # what is thinner than a pixel appears and goes


def test_planes_cut_what_is_near_and_far(picture):
    sound, far, near = (picture(DEPTH, *faults)[0] for faults in ((), ("far-plane=2",), ("near-plane=250",)))
    np.testing.assert_array_equal(far, np.minimum(sound, 200))
    assert (sound < 250).any()
    assert (near >= 250).all()
    np.testing.assert_allclose(near[sound >= 250], sound[sound >= 250], rtol=1e-6)


def test_radial_depth_is_the_distance_along_the_ray(picture):
    at_px = (np.arange(EDGE) + 0.5) / (EDGE / 2) - 1
    lengths = np.sqrt(1 + at_px[:, None] ** 2 + at_px**2)
    sound, radial, half = (
        picture(DEPTH, *faults)[0] for faults in ((), ("radial-depth=1",), ("radial-depth=0.5",))
    )
    np.testing.assert_allclose(radial, sound * lengths, rtol=1e-5)
    np.testing.assert_allclose(half, (sound + radial) / 2, rtol=1e-5)


def test_depth_has_as_many_bits_as_it_says(picture):
    sound, steps, floats, halves = (
        picture(DEPTH, *faults)[0]
        for faults in ((), ("depth-bits=8",), ("depth-mantissa=7",), ("depth-mantissa=10",))
    )
    step_cm = 1e4 / 256
    np.testing.assert_allclose(steps / step_cm, np.round(sound / step_cm), atol=1e-4)
    np.testing.assert_allclose(floats, sound, rtol=2**-8)
    assert (floats.view(np.uint32) != sound.view(np.uint32)).any()
    metres = (sound / 100).astype(np.float64)
    np.testing.assert_allclose(halves / 100, metres.astype(np.float16), rtol=1e-6)


def test_masks_lose_their_colours(picture):
    (sound, _), (blurred, _), (noisy, _), (alike, _) = (
        picture(MASK, *faults) for faults in ((), ("mask-blur=0.5",), ("mask-noise=3",), ("near-colors=0",))
    )
    colors = {tuple(color) for color in sound.reshape(-1, 3).tolist()}
    inside = cv2.erode(sound.astype(np.float32), np.ones((7, 7))) == cv2.dilate(
        sound.astype(np.float32), np.ones((7, 7))
    )
    assert np.array_equal(blurred[inside], sound[inside])
    assert {tuple(color) for color in blurred.reshape(-1, 3).tolist()} - colors
    assert 0 < np.abs(noisy - sound).max() <= 3
    assert len({tuple(color) for color in alike.reshape(-1, 3).tolist()}) <= len(colors)


def test_jpeg_is_worse_with_more_loss(picture):
    sound = picture(LIT)[0]
    errors = [np.abs(picture(LIT, f"jpeg={loss}")[0] - sound).mean() for loss in (1, 30, 90)]
    assert 0 < errors[0] < errors[1] < errors[2]
