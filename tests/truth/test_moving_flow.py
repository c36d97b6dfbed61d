"""Flow of a world in which objects move by themselves, judged by tracing it at both times."""

import numpy as np
from support.traced_frames import traced

import mock_server
from mock_server.scene_file import turned
from omniscv import Pose, cameras, truth
from omniscv.truth.optical_flow import motion

SCENE = mock_server.load_scene("workshop")
BEFORE_THE_CRATE = {"Cabinet": (turned(30), (0.6, -0.85, 0.85))}
WORLDS = [SCENE.at(0.4), SCENE.at(0.75, BEFORE_THE_CRATE)]
BEFORE = Pose.from_angles((0.1, 0.2, 1.1), 20, 5, -3)
AFTER = Pose.from_angles((0.25, 0.1, 1.2), 27, 3, 1)


def test_an_object_that_moves_with_the_camera_has_no_flow():
    """A rigid motion of camera and object together gives no flow, whatever the frame of the object."""
    camera = cameras.create("equirectangular", width=96, height=48)
    layers = traced(WORLDS[0], camera, BEFORE)
    label = SCENE.label("Crate")
    for rest in (Pose.from_angles((0, 0, 0)), Pose.from_angles((3, -1, 0.5), 77, 20, 5)):
        together = {label: motion(BEFORE @ rest, AFTER @ rest)}
        found = truth.flow(
            layers["depth"], camera.unproject(), BEFORE, camera, AFTER, None, layers["labels"], together
        )
        mine = layers["labels"] == label
        assert mine.sum() > 10
        assert np.abs(found.pixels[mine]).max() < 1e-9
        still = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, AFTER)
        np.testing.assert_array_equal(found.pixels[~mine], still.pixels[~mine])
