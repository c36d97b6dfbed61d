"""Depth that does not belong to its colours is named with its size; sound depth is not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.overlapping import MISDESCRIBED, WORLDS, asked, noisy, room, written

from omniscv.importing.conventions import Words

SIZE = {"count": 8, "width": 240, "height": 180}


@cache
def shots(world="boxes", seed=1):
    return room(seed, world=world, **SIZE)


def by_another_camera(world, seed, ratio=1.0, right_m=0.0):
    """Shots whose depth a camera saw with another focal length, and to the right of that of colours."""
    colors = shots(world, seed)
    trace, _ = WORLDS[world](np.random.default_rng(seed), 9)
    rays = colors.rays() * (1 / ratio, 1 / ratio, 1)
    depth = np.zeros_like(colors.depth)
    for i, (R, t) in enumerate(zip(colors.R, colors.t, strict=True)):
        origins = np.tile(t + R @ (right_m, 0, 0), (rays[..., 0].size, 1))
        lengths, _, _ = trace(origins, rays.reshape(-1, 3) @ R.T)
        depth[i] = lengths.reshape(depth.shape[1:])
    return replace(colors, depth=depth)


def changed(world, seed, change):
    return replace(shots(world, seed), depth=change(shots(world, seed).depth))


def of_buffer(depth, near=0.1, far=100.0):
    return (1 / depth - 1 / near) / (1 / far - 1 / near)


MISFITS = {
    "upside down": (lambda *at: changed(*at, lambda depth: depth[:, ::-1]), "depth the other way up"),
    "mirrored": (lambda *at: changed(*at, lambda depth: depth[:, :, ::-1]), "depth with left and right exch"),
    "turned": (lambda *at: changed(*at, lambda depth: depth[:, ::-1, ::-1]), "depth turned by 180 degrees"),
    "another field of view": (lambda *at: by_another_camera(*at, 0.75), "a lens of its own, 0.7"),
    "a Kinect's": (lambda *at: by_another_camera(*at, 585 / 525, -0.0245), "a lens of its own, 1.1"),
    "25 mm aside": (lambda *at: by_another_camera(*at, 1, 0.025), "a camera of its own, whose points lie +2"),
    "a z-buffer": (lambda *at: changed(*at, of_buffer), "a z-buffer, near 0.1 m and far"),
    "inverse": (lambda *at: changed(*at, lambda depth: 1 / depth), "numbers that are 1 / depth"),
    "squared": (lambda *at: changed(*at, lambda depth: depth**2), "numbers that are the square of depth"),
    "of other frames": (
        lambda *at: changed(*at, lambda depth: depth[[5, 2, 7, 0, 6, 3, 1, 4]]),
        "depth agrees: ",
    ),
}
QUICK = ("upside down", "a Kinect's", "inverse")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.soak) for name in MISFITS]
)
def test_depth_that_does_not_belong_to_its_colours_is_named(name):
    made, says = MISFITS[name]
    verdict = asked(made("boxes", 1), Words())
    assert verdict.misfit is not None
    assert says in verdict.misfit.shows


@pytest.mark.soak
@pytest.mark.parametrize("world", WORLDS)
def test_no_misfit_is_named_as_another_one(world):
    """Where edges of depth and colours do not meet, as of walls with strong patterns, some are not told."""
    missed = []
    for seed in (1, 2, 3):
        for name, (made, says) in MISFITS.items():
            misfit = asked(made(world, seed), Words()).misfit
            if misfit is None:
                missed.append((seed, name))
            else:
                assert says in misfit.shows, (seed, name)
    assert len(missed) <= 15, missed


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(2, 8))])
@pytest.mark.parametrize(
    "world", ["boxes", *(pytest.param(name, marks=pytest.mark.soak) for name in ("mesh", "mujoco"))]
)
def test_sound_depth_belongs_to_its_colours(world, seed):
    sound = shots(world, seed)
    assert asked(sound, Words()).misfit is None
    assert asked(noisy(sound, seed), Words()).misfit is None


def test_two_frames_that_see_different_places_are_taken_as_said():
    """Of thousands of conventions one always makes something agree."""
    far = room(2, count=40)
    for first, second in ((0, 20), (3, 19), (12, 33), (8, 27)):
        pair = replace(
            far,
            depth=far.depth[[first, second]],
            lit=far.lit[[first, second]],
            R=far.R[[first, second]],
            t=far.t[[first, second]],
        )
        verdict = asked(pair, Words())
        assert not verdict.contradicts
        assert verdict.misfit is None
    beside = replace(far, depth=far.depth[:2], lit=far.lit[:2], R=far.R[:2], t=far.t[:2])
    told, _ = MISDESCRIBED["opengl"]
    assert asked(beside, Words(), *written(beside, **told)).contradicts
