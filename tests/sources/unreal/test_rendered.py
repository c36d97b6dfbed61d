"""Images from the live source, with every dialect."""

import numpy as np
import pytest
from support.faces import CENTER
from support.unreal import MODES

import mock_server
import omniscv
from omniscv.chart.truth import traced
from omniscv.errors import MissingCaptureError

SIZE = 48
ROOM = mock_server.load_scene("four-wall")


@pytest.mark.parametrize(("dialect", "strategy"), [("0.3.10", "auto"), ("N1", "cube")])
def test_a_panorama_is_the_traced_one_also_from_its_recording(dialect, strategy, tmp_path):
    camera = omniscv.cameras.create("equirectangular", width=128, height=64)
    pose = omniscv.Pose.from_angles(CENTER, yaw_deg=25, pitch_deg=10, roll_deg=-5)
    options = {"modes": MODES, "strategy": strategy, "face_size": SIZE}
    with (
        omniscv.open_source(f"mock://four-wall?dialect={dialect}&size={SIZE}x{SIZE}") as live,
        omniscv.record(live, tmp_path / "room.sqlite") as source,
    ):
        image = omniscv.render(camera, pose, source, **options)
    truth = traced(ROOM, camera, pose)
    assert image.valid.all()
    # Pixels on edges of objects: 2 % of them at this size.
    assert (image.labels == truth.label).mean() > 0.97
    error = np.abs(image.depth - truth.distance) / truth.distance
    assert np.median(error) < 2.0**-11  # half floats
    with omniscv.open_source(tmp_path / "room.sqlite") as replay:
        again = omniscv.render(camera, pose, replay, **options)
    for layer in ("lit", "object_mask", "labels", "depth", "normals"):
        np.testing.assert_array_equal(getattr(again, layer), getattr(image, layer), err_msg=layer)


def test_a_window_that_shows_too_little_is_reported():
    """As it opens, 640 x 480: colour and depth can be widened until they show 90 degrees up and down too."""
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    pose = omniscv.Pose.from_angles(CENTER)
    with omniscv.open_source("mock://four-wall?dialect=0.3.10&size=64x48") as source:
        assert omniscv.render(camera, pose, source, ("lit", "depth")).valid.all()
        with pytest.raises(MissingCaptureError, match=r"they came as 64 x 48 of 90 degrees.*square pictures"):
            omniscv.render(camera, pose, source, ("object_mask",))
