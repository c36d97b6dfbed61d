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
EXACT = {"strategy": "exact"}
CUBE = {"strategy": "cube"}
CASES = {
    "push-broom-20": (ALONG, BY_WALL, EXACT | {"viewpoints": 20}),
    "push-broom": (create("push-broom", 50, 40, travel=(1, 0, 0), fov_deg=95), BY_WALL, {"accuracy": 0.1}),
    "panorama": (create("noncentral-panorama", 96, 48, radius=0.5), BY_WALL, EXACT | {"viewpoints": 9}),
    "centre-right-behind-a-wall": (
        create("noncentral-panorama", width=96, height=40, radius=1.33),
        Pose.from_angles((1.264, 2.319, 1.984), 37.9, 56.7, 151.8),
        CUBE | {"viewpoints": 6},
    ),
    # A column whose centre lies 0.1 mm beyond the ceiling, which half floats do not tell.
    "mock://six-wall": (
        create("noncentral-panorama", width=159, height=51, radius=0.8848034526754156),
        Pose.from_angles((3.5699475547949464, -1.9086233142483346, 1.9513983729138498),
                         67.3273578197774, -51.66423899981052, -66.56996205040052),
        CUBE | {"viewpoints": 9},
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
        image = omniscv.render(camera, pose, source, MODES, **{"face_size": 128, **way})
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
