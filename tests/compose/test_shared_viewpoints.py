"""Images with fewer viewpoints than rays, where a viewpoint or a pixel's own centre lies beyond a wall."""

import numpy as np
import pytest
from support.judged import Errors

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.geometry import Pose

MODES = ("object_mask", "depth")
UNMARKED = 0.0005  # of the valid pixels of an image
ALONG = create("push-broom", width=101, height=79, travel=(3, 0, 0), fov_deg=95)
BY_WALL = Pose.from_angles((0.3, 2.2, 1.3), yaw_deg=180)
EXACT, CUBE = {"strategy": "exact"}, {"strategy": "cube"}
CASES = {
    **{f"push-broom-{count}": (ALONG, BY_WALL, EXACT | {"viewpoints": count}) for count in (4, 20)},
    "centre-right-behind-a-wall": (
        create("noncentral-panorama", width=96, height=80, radius=1.33),
        Pose.from_angles((1.264, 2.319, 1.984), 37.9, 56.7, 151.8),
        CUBE | {"viewpoints": 6, "face_size": 128},
    ),
    # A column whose centre lies 0.1 mm beyond the ceiling, which half floats do not tell.
    "mock://six-wall": (
        create("noncentral-panorama", width=159, height=151, radius=0.8848034526754156),
        Pose.from_angles((3.5699475547949464, -1.9086233142483346, 1.9513983729138498),
                         67.3273578197774, -51.66423899981052, -66.56996205040052),
        CUBE | {"viewpoints": 9, "face_size": 128},
    ),
    # Floats: rounding to half floats is larger than what a curved surface adds, seen from a centre nearby.
    "scene://four-wall?traces=0": (
        create("push-broom", width=76, height=66, travel=(0.95, 0.157, 0), focal=25.64),
        Pose.from_angles((-0.136, -0.096, 1.239), -152.4, 14.1, 15.7),
        EXACT | {"viewpoints": 12},
    ),
}  # fmt: skip
"""Some by the address of their source; the others' is ``mock://four-wall``."""


def judged(camera, pose, way, uri="mock://four-wall"):
    scene = mock_server.load_scene(uri.partition("://")[2].partition("?")[0])
    with omniscv.open_source(uri) as source:
        image = omniscv.render(camera, pose, source, MODES, **{"face_size": 224, **way})
    toward = pose.to_world(camera.unproject().origins) - pose.position
    away = np.linalg.norm(toward, axis=-1)
    centers = np.broadcast_to(pose.position, toward.shape)
    turns = [np.zeros(3), *0.03 * np.eye(3), *-0.03 * np.eye(3)]
    with np.errstate(invalid="ignore"):
        along = toward / away[..., None]
        hidden = [scene.trace(centers, along + turn).distance < away for turn in turns]
    wrong = np.all([image.occluded != each for each in hidden], axis=0)
    return Errors(image, scene), wrong & image.valid


@pytest.mark.parametrize("case", CASES)
def test_what_the_shared_centre_does_not_see_is_marked(case):
    given = {"uri": case} if "://" in case else {}
    errors, wrongly_hidden = judged(*CASES[case], **given)
    image = errors.image
    assert errors.uncovered.sum() <= max(1, UNMARKED * image.valid.sum())
    assert given or not wrongly_hidden.any()


def drawn_near_a_wall(seed):
    """A camera whose centres reach up to 0.6 m from its position, 0.1 to 0.5 m from a wall or a corner."""
    rng = np.random.default_rng(seed)
    sides = rng.choice((-1, 1), 2) * ((3.0, 2.5) - rng.uniform(0.1, 0.5, 2))
    x, y = np.where(rng.permutation([True, seed % 2 == 0]), sides, rng.uniform(-1, 1, 2))
    pose = Pose.from_angles((x, y, rng.uniform(0.3, 2.5)), *rng.uniform(-180, 180, 3))
    models = (
        create("noncentral-panorama", width=96, height=48, radius=rng.uniform(0.2, 0.6)),
        create("push-broom", width=72, height=56, travel=rng.uniform((0.1, -1, -1), 1), fov_deg=90),
    )
    ways = (EXACT, EXACT, CUBE, {})
    way = ways[seed % 4] if seed % 4 == 3 else ways[seed % 4] | {"viewpoints": int(rng.integers(3, 24))}
    return models[seed % 2], pose, way


@pytest.mark.parametrize("seed", range(4))
def test_near_walls(seed):
    errors, wrongly_hidden = judged(*drawn_near_a_wall(seed))
    image = errors.image
    assert errors.uncovered.sum() <= max(2, UNMARKED * image.valid.sum())
    assert not wrongly_hidden.any()
