"""Sets of captures are proven to show one instant: torn ones are found, taken again, or refused."""

import random
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import CountingSource

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import OtherMomentError, TornSetError
from omniscv.geometry.instant import Instant
from omniscv.job import Job
from omniscv.make import capture as capture_job
from omniscv.sources import Request, SourceWrapper
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.scene import SceneSource
from omniscv.sources.stillness import TRIES

WORKSHOP = mock_server.load_scene("workshop")
MODES = ("lit", "object_mask", "depth")
LAYERS = ("lit", "labels", "depth")
POSE = omniscv.Pose.from_angles((0, 0, 1.2))
CENTRAL = create("equirectangular", width=32, height=16)
CIRCLE = create("noncentral-panorama", width=8, height=4, radius=0.3)
LEFT = create("pinhole", width=16, height=16, fov_deg=100)
RIG = Rig(
    {
        "left": RigCamera(LEFT, omniscv.Pose((-0.1, 0, 0), np.eye(3))),
        "all": RigCamera(CENTRAL, omniscv.Pose((0.1, 0, 0), np.eye(3))),
    }
)


class Unfrozen(SourceWrapper):
    """A scene whose clock goes on with every capture; it knows no state but the still one.

    ``time_of`` returns seconds of its clock, by how many captures were made before.
    """

    def __init__(self, time_of):
        super().__init__(SceneSource(WORKSHOP))
        self._time_of = time_of
        self.made = 0
        self.requests = []

    @property
    def capabilities(self):
        return replace(super().capabilities, moves=True)

    def capture(self, requests):
        for request in requests:
            request.check_state(self.state, "unfrozen")
            instant = Instant(time=self._time_of(self.made))
            self.made += 1
            self.requests.append(request)
            with self.at(instant) as there:
                (capture,) = there.capture([Request(request.view, request.mode, there.state)])
            yield replace(capture, request=request)


class Frozen(CountingSource):
    """A source whose world may move, and that counts what is captured."""

    @property
    def capabilities(self):
        return replace(super().capabilities, moves=True)

    def at(self, instant):
        return Frozen(super().at(instant))


def scene_at(time):
    return SceneSource(WORKSHOP, instant=Instant(time=time))


def central(source, modes=MODES):
    return [omniscv.render(CENTRAL, POSE, source, modes, face_size=16)]


def exact(source, modes=MODES):
    return [omniscv.render(CIRCLE, POSE, source, modes, strategy="exact")]


def planned(source, modes=MODES):
    return [omniscv.render(CIRCLE, POSE, source, modes, face_size=8)]


def rig(source, modes=MODES):
    return list(omniscv.render_rig(RIG, POSE, source, modes, face_size=16).values())


SHOTS = (central, exact, planned, rig)
SEEDS = [1, pytest.param(100, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]


def same(images, others):
    return all(
        np.array_equal(image[name], other[name])
        for image, other in zip(images, others, strict=True)
        for name in LAYERS
    )


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("shoot", SHOTS)
def test_captures_of_a_moving_world_are_never_delivered(shoot, seeds):
    for seed in range(seeds):
        draw = random.Random(seed)
        start = draw.uniform(0, 10)
        tick = draw.choice([1 / 120, 1 / 60, 1 / 30])
        world = Unfrozen(lambda made, start=start, tick=tick: start + made * tick)
        with world, pytest.raises(TornSetError, match="expected a world that stands still"):
            shoot(world)


@pytest.mark.parametrize("shoot", SHOTS)
def test_a_world_that_stands_still_is_delivered_as_if_nothing_was_proven(shoot):
    with scene_at(1.3) as still, Frozen(scene_at(1.3)) as frozen:
        assert same(shoot(frozen), shoot(still))


def test_a_tick_in_the_middle_of_a_set_is_taken_again():
    with scene_at(0.5) as before, scene_at(1.5) as behind:
        allowed = [central(before), central(behind)]
    for seed in range(4):
        late = random.Random(seed).randrange(30)
        with Unfrozen(lambda made, late=late: 0.5 if made < late else 1.5) as world:
            images = central(world)
        assert any(same(images, each) for each in allowed)


def test_a_source_that_is_still_pays_nothing_and_colours_alone_are_proven_by_depth_and_masks():
    with scene_at(0.7) as source:
        frozen = Frozen(source)
        alone = Frozen(source)
        plain = CountingSource(source)
        central(frozen)
        (image,) = central(alone, ("lit",))
        (wanted,) = central(plain)
    views = {request.view for request in plain.requests}
    assert len(plain.requests) == 3 * len(views)
    assert len(frozen.requests) == len(plain.requests) + 2 * len(views)
    assert np.array_equal(image.lit, wanted.lit)
    assert {request.mode for request in alone.requests} == {"lit", "depth", "object_mask"}
    with Unfrozen(lambda made: 0.02 * made) as world, pytest.raises(TornSetError):
        central(world, ("lit",))


def test_a_recording_keeps_a_set_whole_or_not_at_all(tmp_path):
    path = tmp_path / "room.sqlite"
    with scene_at(0.5) as still:
        wanted = central(still)
    with omniscv.record(Unfrozen(lambda made: 0.5), path) as source:
        central(source)
    held = info(path)
    with omniscv.record(Unfrozen(lambda made: 0.5 + 0.02 * made), path) as source:
        with pytest.raises(TornSetError):
            omniscv.render(CENTRAL, omniscv.Pose.from_angles((0.3, 0, 1.2)), source, MODES, face_size=16)
        assert source.scene_identity.name == "workshop"
    assert (info(path), verify(path).ok) == (held, True)
    with omniscv.open_source(path) as replay:
        assert same(central(replay), wanted)


def test_a_recorded_set_is_compared_with_the_world_as_it_is(tmp_path):
    """A resumed recording of a world that has moved since does not mix both; the repeats are not recorded."""

    class Broken(Unfrozen):
        def capture(self, requests):
            for request in requests:
                if request.again:
                    raise BrokenPipeError("standard output")
                yield from super().capture([request])

    path = tmp_path / "room.sqlite"
    with omniscv.record(Broken(lambda made: 0.5), path) as source:
        with pytest.raises(BrokenPipeError, match="standard output"):  # errors within a set pass as they are
            central(source)
        assert not any(source.capture([]))
    assert info(path).captures == {}
    with omniscv.record(Unfrozen(lambda made: 0.5), path) as source:
        central(source, ("depth",))
    held = info(path).captures
    assert held == {"depth": 6, "object_mask": 6}
    with omniscv.record(Unfrozen(lambda made: 1.5), path) as source, pytest.raises(TornSetError):
        central(source)
    assert info(path).captures == held


@pytest.mark.parametrize("shoot", SHOTS)
def test_what_a_recording_holds_is_replayed_while_the_world_goes_on(shoot, tmp_path):
    """A program that is run again beside its recording captures nothing; new captures beside held ones of
    another moment are refused at once, in a line that says what to do."""
    path = tmp_path / "room.sqlite"
    with omniscv.record(Unfrozen(lambda made: 0.5), path) as source:
        first = shoot(source)
    held = info(path).captures
    with Unfrozen(lambda made: 1.5) as world, omniscv.record(world, path) as source:
        assert same(shoot(source), first)
        assert world.made == 0
        wanted = r"room.sqlite: expected a world that stands still, as the recording shows it.*new file"
        with pytest.raises(OtherMomentError, match=wanted):
            shoot(source, (*MODES, "normals"))
        assert world.made < 3 * sum(held.values())
    assert info(path).captures == held


def test_a_job_captures_each_frame_until_it_is_still(tmp_path):
    path = tmp_path / "room.sqlite"
    options = omniscv.RenderOptions(face_size=16)
    moving = {"world": Unfrozen(lambda made: 0.5 if made < 7 else 1.5)}
    omniscv.sources.register("moving", lambda address: moving[address.partition("://")[2]])
    job = Job("moving://world", (POSE,), {"pano": CENTRAL}, tmp_path, MODES, options=options)
    assert capture_job(job, path).needed == 18
    assert moving["world"].made > 18 + 12
    with omniscv.open_source(path) as replay, scene_at(1.5) as behind:
        assert same(central(replay), central(behind))


def test_frozen_moments_equal_the_scene_at_their_times(tmp_path):
    path = tmp_path / "room.sqlite"
    times = (0.0, 0.4, 1.1)
    with omniscv.record(Frozen(SceneSource(WORKSHOP)), path) as source:
        for time in times:
            with source.at(Instant(time=time)) as there, scene_at(time) as wanted:
                assert same(central(there), central(wanted))
    with omniscv.open_source(path) as replay:
        for time in times:
            with replay.at(Instant(time=time)) as there, scene_at(time) as wanted:
                assert same(central(there), central(wanted))
                assert there.geometry().to_dict() == wanted.geometry().to_dict()


def test_the_bound_on_tries_is_kept():
    with Unfrozen(lambda made: 0.05 * made) as world, pytest.raises(TornSetError):
        central(world)
    views = {request.view for request in world.requests}
    assert len(world.requests) <= TRIES * 5 * len(views)
