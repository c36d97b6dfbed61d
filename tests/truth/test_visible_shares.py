"""How much of objects is seen: against rays that meet one object alone, in every kind of camera."""

import numpy as np
import pytest
from pycocotools import mask as cocomask
from support.observed import observed

import mock_server
import omniscv
from omniscv import cameras
from omniscv.dataset import truths
from omniscv.errors import ArgumentError
from omniscv.frame.classes import ClassTable, SemanticClass
from omniscv.sources.scene import SceneSource
from omniscv.truth.visibility import centers_ball, groups_apart

SCENE = mock_server.load_scene("four-wall")
THINGS = [name for name in SCENE.objects if not name.startswith("Layout")]
HERE = omniscv.Pose.from_angles((-0.2, 0.1, 1.3), yaw_deg=140)
CAMERAS = {
    "equirectangular": cameras.create("equirectangular", width=160, height=80),
    "fisheye": cameras.create("fisheye-equidistant", width=96, height=96, fov_deg=185),
    "panorama on a circle": cameras.create("noncentral-panorama", width=64, height=32, radius=0.2),
}


def alone(seen_frame, name):
    """(H, W) the pixels whose rays meet an object when nothing else is there."""
    image = seen_frame.image
    rays = image.camera.unproject()
    origins_w = np.broadcast_to(image.centers_w, rays.origins.shape)
    others = set(SCENE.objects) - {name}
    return (SCENE.trace(origins_w, rays.directions @ image.pose.R_w_c.T, others).label > 0) & rays.valid


@pytest.fixture(scope="module", params=CAMERAS)
def shares(request):
    camera = CAMERAS[request.param]
    options = {"face_size": 96} if camera.central else {"viewpoints": 4, "strategy": "cube", "face_size": 48}
    with omniscv.open_source("scene://four-wall") as source:
        seen_frame = observed(source, camera, HERE, ("object_mask",), **options)
        return seen_frame, truths.get("amodal").apply(seen_frame, {"kind": "masks"})


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
def test_shares_agree_with_traced_rays(shares):
    seen_frame, records = shares
    assert {record["name"] for record in records} <= set(THINGS)
    seen = np.unique(seen_frame.image.labels).tolist()
    things = {i for name, i in seen_frame.instances.items() if name in THINGS and i in seen}
    assert things <= {record["instance_id"] for record in records}
    hidden = 0
    for record in records:
        exact = alone(seen_frame, record["name"])
        visible = seen_frame.image.labels == record["instance_id"]
        mask = cocomask.decode(record["segmentation"]).astype(bool)
        edge = np.count_nonzero(exact ^ eroded(exact))
        assert np.count_nonzero(mask ^ exact) <= 0.4 * edge + 4  # where a capture's grid decides
        assert (mask >= visible).all()
        assert (record["px_all"], record["px_visib"]) == (np.count_nonzero(mask), np.count_nonzero(visible))
        assert record["visib_fract"] == record["px_visib"] / record["px_all"] <= 1
        hidden += record["visib_fract"] < 0.98
    assert hidden >= 1  # the shelf behind books, the frame behind its door, ...


def eroded(mask):
    inner = mask.copy()
    for axis, by in ((0, 1), (0, -1), (1, 1), (1, -1)):
        inner &= np.roll(mask, by, axis)
    return inner


def test_hidden_objects_have_the_share_0():
    """A ball behind a board, in a scene: a live server is not asked about objects that nothing shows."""
    objects = {
        "Ball": {"solids": [{"sphere": 0.2, "at": [3, 0, 0]}]},
        "Board": {"solids": [{"box": [0.1, 2, 2], "at": [1.5, 0, 0]}]},
    }
    with SceneSource(mock_server.Scene("board", {"objects": objects})) as source:
        seen_frame = observed(source, CAMERAS["fisheye"], omniscv.Pose.from_angles((0, 0, 0)))
        records = truths.get("amodal").apply(seen_frame, {})
    ball, board = records
    assert (ball["name"], ball["px_visib"], ball["visib_fract"], board["visib_fract"]) == ("Ball", 0, 0, 1)
    assert ball["px_all"] > 8


def test_a_live_server_has_the_same_shares_and_shows_all_again():
    camera = cameras.create("equirectangular", width=96, height=48)
    options = {"face_size": 48}
    with omniscv.open_source("scene://four-wall") as source:
        wanted = truths.get("amodal").apply(observed(source, camera, HERE, **options), {})
    with mock_server.serve("four-wall") as server, omniscv.open_source(server.uri) as source:
        seen_frame = observed(source, camera, HERE, **options)
        found = truths.get("amodal").apply(seen_frame, {})
        assert not any(each.hidden for each in server.world.objects.values())
    assert {record["name"] for record in found} - {record["name"] for record in wanted} <= set(SCENE.objects)
    by_name = {record["name"]: record for record in found}
    for record in wanted:
        if record["px_visib"]:
            assert by_name[record["name"]]["visib_fract"] == pytest.approx(record["visib_fract"], abs=0.02)


def test_stuff_has_no_share_and_recordings_are_refused(tmp_path):
    table = ClassTable({"stuff": SemanticClass(1, "stuff", stuff=True)}, dict.fromkeys(THINGS[1:], "stuff"))
    with omniscv.record(omniscv.open_source("scene://four-wall"), tmp_path / "a.sqlite") as source:
        observed(source, CAMERAS["fisheye"], HERE, ("object_mask",), face_size=32)
    with omniscv.open_source("scene://four-wall") as source:
        seen_frame = observed(source, CAMERAS["fisheye"], HERE, classes=table, face_size=64)
        assert {r["name"] for r in truths.get("amodal").apply(seen_frame, {})} <= {THINGS[0]}
    with omniscv.open_source(tmp_path / "a.sqlite") as replay:
        recorded = observed(replay, CAMERAS["fisheye"], HERE, ("object_mask",), face_size=32)
        with pytest.raises(ArgumentError, match="expected one that can hide objects, got RecordedSource"):
            truths.get("amodal").apply(recorded, {})


def test_objects_of_a_group_cannot_hide_each_other():
    with omniscv.open_source("scene://four-wall") as source:
        boxes = source.geometry().boxes
    rng = np.random.default_rng(7)
    for _ in range(3):
        center_w = rng.uniform([-1.5, -1.5, 0.5], [1.5, 1.5, 2.2])
        radius = rng.choice([0.0, 0.3])
        groups = groups_apart(THINGS, boxes, center_w, radius)
        assert sorted(name for group in groups for name in group) == THINGS
        aside, directions = rng.normal(size=(2, 20_000, 3))
        origins = center_w + radius * aside / np.linalg.norm(aside, axis=1, keepdims=True)
        for group in groups:
            met = np.zeros(len(directions), int)
            for name in group:
                met += SCENE.trace(origins, directions, set(SCENE.objects) - {name}).label > 0
            assert met.max() <= 1
    # Without a box nothing is known.
    assert groups_apart(["A", "B"], {}, np.zeros(3), 0.0) == [("A",), ("B",)]


def test_a_ball_holds_all_optical_centres():
    for camera in CAMERAS.values():
        rays = camera.unproject()
        center, radius = centers_ball(HERE.to_world(rays.origins))
        far = np.linalg.norm(HERE.to_world(rays.origins[rays.valid]) - center, axis=-1)
        assert far.max() <= radius + 1e-12
        assert radius == pytest.approx(0.2 if not camera.central else 0.0, abs=0.01)
