"""A rig's cameras share what they can: captures counted, and images as they are alone."""

from collections import Counter
from collections.abc import Iterable, Iterator

import pytest

import omniscv
from omniscv import Pose, Rig, RigCamera, cameras
from omniscv.sources.base import Capture, Request, SourceWrapper

LENS = cameras.create("fisheye-equidistant", width=24, height=24, fov_deg=190)
SPHERE = cameras.create("equirectangular", width=32, height=16)
AROUND = {f"lens{yaw}": RigCamera.turned(LENS, yaw_deg=yaw) for yaw in (0, 90, 180, 270)}
ROUND = Rig({**AROUND, "sphere": RigCamera(SPHERE)})


class Counting(SourceWrapper):
    """Counts the captures that are made of each request."""

    def __init__(self, source: omniscv.sources.base.Source) -> None:
        super().__init__(source)
        self.counts: Counter[Request] = Counter()

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for capture in self._source.capture(requests):
            self.counts[capture.request] += 1
            yield capture


@pytest.fixture
def source() -> Iterator[Counting]:
    with omniscv.open_source("scene://four-wall") as scene, Counting(scene) as counting:
        yield counting


def test_five_cameras_at_fifty_poses_take_six_captures_a_pose(source: Counting) -> None:
    """Four fisheyes and a panorama at one centre; the rig turns and moves, its centre does not repeat."""
    for i in range(50):
        pose = Pose.from_angles((-1 + i / 25, 0.3, 1.5), yaw_deg=7 * i, pitch_deg=i - 25)
        images = omniscv.render_rig(ROUND, pose, source, face_size=16)
        assert list(images) == [*AROUND, "sphere"]
        assert all(image.valid.any() for image in images.values())
    assert set(source.counts.values()) == {1}
    assert Counter(request.mode for request in source.counts) == {"lit": 300}
    places = {tuple(request.view.pose.position) for request in source.counts}
    assert len(places) == 50
