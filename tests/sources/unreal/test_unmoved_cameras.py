"""A camera that is not where it was set, or never moves, is refused by what it reports and shows."""

import copy

import pytest
from support.faces import face_requests

import mock_server
import omniscv
from mock_server.dialects import v1
from mock_server.scene import Scene
from omniscv.cameras import create
from omniscv.errors import MisplacedCameraError
from omniscv.geometry import Pose
from omniscv.job import load
from omniscv.make import capture
from omniscv.sources.recording.inspection import info, verify

MODES = ("lit", "object_mask", "depth")
START = (0.0, 0.0, 1.5)
ELSEWHERE = (0.3, -0.2, 1.4)
MODERN = pytest.mark.parametrize("dialect", ["M", "N3"])


def serve(dialect, scene="four-wall", **options):
    return mock_server.serve(scene, dialect=dialect, size=(32, 32), **options)


def faces(center, modes=MODES):
    return face_requests(32, modes, center=center)


@MODERN
@pytest.mark.parametrize(
    ("center", "says"),
    [
        (
            ELSEWHERE,
            r"expected a camera at \(0.3, -0.2, 1.4\) m, got 0.374 m away, at \(0, 0, 1.5\) m: a coll",
        ),
        (
            START,
            r"expected other pictures in 6 directions at \(0, 0, 1.5\) m, got the same to the byte in all",
        ),
    ],
    ids=["elsewhere", "at the place"],
)
def test_a_game_that_ignores_poses_is_refused_and_nothing_is_recorded(dialect, center, says, tmp_path):
    path = tmp_path / "room.sqlite"
    with serve(dialect, faults=["ignore-pose"]) as server:
        live = omniscv.open_source(server.uri)
        with omniscv.record(live, path) as source, pytest.raises(MisplacedCameraError, match=says):
            list(source.capture(faces(center)))
    assert info(path).captures == {}


@pytest.fixture
def frozen(monkeypatch):
    """Pictures show the first pose of each camera for ever; the pose reads back as it was set."""
    first = {}
    image = DIALECT._image

    def of_first(self, mode, camera, form):
        pose = first.setdefault(id(camera), (camera.location, camera.rotation))
        still = copy.copy(camera)
        still.location, still.rotation = pose
        return image(self, mode, still, form)

    monkeypatch.setattr(DIALECT, "_image", of_first)


@MODERN
def test_pictures_that_stay_while_the_pose_reads_back_as_set_are_evidence(dialect, frozen, tmp_path):
    poses = [{"position": [0.1 * i, 0, 1.5], "yaw_deg": 10 * i} for i in range(6)]
    views = {"eye": {"model": "pinhole", "width": 32, "height": 24, "fov_deg": 60}}
    room = {"eye": {"model": "equirectangular", "width": 32, "height": 16}}
    for cameras, says in ((room, "6 directions at"), (views, "in 4 directions")):
        with serve(dialect) as server:
            job = load({"source": server.uri, "cameras": cameras, "poses": poses, "modes": list(MODES)})
            with pytest.raises(MisplacedCameraError, match=f"{says}.*in all modes: the camera does not move"):
                capture(job, tmp_path / f"{len(says)}.sqlite")


DIALECT = next(cls for cls in vars(v1).values() if isinstance(cls, type) and "_set_pose" in vars(cls))


@MODERN
def test_a_camera_that_a_collision_moves_is_refused_with_how_far(dialect, monkeypatch):
    away_cm = [0.0]
    place = DIALECT._set_pose

    def pushed(self, attribute, camera, *values):
        moved = (values[0] + away_cm[0], *values[1:]) if attribute == "location" else values
        place(self, attribute, camera, *moved)

    monkeypatch.setattr(DIALECT, "_set_pose", pushed)
    with serve(dialect) as server, omniscv.open_source(server.uri) as source:
        assert len(list(source.capture(faces(ELSEWHERE)))) == 18
        assert server.statistics.total("vget /camera/1/location") == 1
        list(source.capture([*faces(START), *faces(ELSEWHERE)]))
        assert server.statistics.total("vget /camera/1/location") == 3  # once a place
        away_cm[0] = 16.0
        with pytest.raises(MisplacedCameraError, match=r"at \(0, 0, 1.5\) m, got 0.16 m away"):
            list(source.capture(faces(START)))


GREY = {"kind": "plain", "colors": [[0.5, 0.5, 0.5]]}
NOTHING = {
    "sky": [0, 0, 0],
    "objects": {"Speck": {"texture": GREY, "solids": [{"box": [0.001] * 3, "at": [900, 900, 1]}]}},
}


def test_a_black_world_with_nothing_in_it_says_so(tmp_path):
    world = Scene("nothing", NOTHING)
    with serve("N3", world) as server, omniscv.open_source(server.uri) as source:
        with pytest.raises(
            MisplacedCameraError, match="or there is nothing to see, as in a dark and empty level"
        ):
            list(source.capture(faces(START)))
        assert len(list(source.capture(faces(START, ("object_mask",))))) == 6  # alone it is no evidence
        assert len(list(source.capture(faces(START, ("depth",))))) == 6  # an open sky


def test_the_check_of_a_recording_names_places_whose_pictures_are_all_equal(tmp_path):
    from omniscv.sources.scene import SceneSource

    path = tmp_path / "old.sqlite"
    with omniscv.record(SceneSource(Scene("nothing", NOTHING)), path) as source:
        omniscv.render(
            create("equirectangular", 32, 16), Pose.from_angles(START), source, MODES, face_size=16
        )
    faults = verify(path).faults
    assert len(faults) == 1
    assert "6 views at (0, 0, 1.5) m: expected a picture of each, got equal ones in all modes" in faults[0]
    with omniscv.record(omniscv.open_source("scene://four-wall"), tmp_path / "room.sqlite") as source:
        omniscv.render(
            create("equirectangular", 32, 16), Pose.from_angles(START), source, MODES, face_size=16
        )
    assert verify(tmp_path / "room.sqlite").ok
