"""The baseline's steps: each against a room that is known, and the search against all other rooms."""

import numpy as np
import pytest
from support.rooms import PLAIN, room_of_plan, room_of_scene

import mock_server
from omniscv import Pose, cameras
from omniscv.evaluate import manhattan
from omniscv.evaluate.layout import scores
from omniscv.evaluate.layout_baseline import corner_pixels, edge_support, predict, refined
from omniscv.evaluate.layout_evidence import evidence
from omniscv.evaluate.layout_predictions import Prediction
from omniscv.evaluate.layout_set import known_shot
from omniscv.evaluate.panorama_lines import line_segments
from omniscv.evaluate.room_hypotheses import Hypothesis, Support, row_of, score, visible_walls
from omniscv.evaluate.room_search import DISTANCES, HEIGHTS, best_rooms
from omniscv.truth.cor_id import cor_id
from omniscv.truth.metrics import layout_scores
from omniscv.truth.room_surfaces import first_hits

PANORAMA = cameras.create("equirectangular", 512, 256)
ROWS, COLUMNS = 64, 128
YAWS_DEG = {"four-wall": 3.0, "six-wall": 50.0}
ROOMS = {
    "four": Hypothesis(None, (1.2, 2.0, 0.9, 1.5), 0.9),
    "open": Hypothesis(1, (1.2, 2.0, 2.4, 1.5, 0.8, 1.1), 0.9),
    "hidden": Hypothesis(2, (1.2, 2.0, 2.4, 2.9, -0.3, 1.2), 0.9),
    "mirrored": Hypothesis(0, (2.4, 2.0, 1.2, 0.9, 0.9, -0.2), 0.9),
}


def pose_at(yaw_deg):
    return Pose.from_angles((0.4, -0.3, 1.5), yaw_deg=yaw_deg)


@pytest.fixture(scope="module")
def shots():
    return {name: rendered(name, pose_at(yaw_deg)) for name, yaw_deg in YAWS_DEG.items()}


def rendered(name, pose):
    """A traced panorama and its truth."""
    scene, room, rays = mock_server.load_scene(name), room_of_scene(name), PANORAMA.unproject()
    origins = np.broadcast_to(pose.position, rays.directions.shape)
    hits = scene.trace(origins, rays.directions @ pose.R_w_c.T)
    return known_shot("shot", np.round(255 * hits.color).astype(np.uint8), room, PANORAMA, pose)


def ideal(room):
    """Support in which only the edges of a room have lines, two rows wide."""
    azimuths = (np.arange(COLUMNS) + 0.5) * 2 * np.pi / COLUMNS
    direction, away = visible_walls(room.corners(), azimuths)
    edges = np.zeros((2, 4, ROWS, COLUMNS))
    for part, slope in zip(edges, (room.height / away, -1 / away), strict=True):
        off = np.arange(ROWS)[:, None] + 0.5 - row_of(slope, ROWS)
        part[direction, :, np.arange(COLUMNS)] = np.exp(-0.5 * (off.T / 1.5) ** 2)
    return Support(*edges, np.zeros((ROWS + 1, COLUMNS)), 0.0, 0.0)


@pytest.mark.parametrize("kind", ROOMS)
def test_the_search_and_its_refinement_find_the_room_whose_edges_are_drawn(kind):
    truth = ROOMS[kind]
    support = ideal(truth)
    rooms = [room for room in best_rooms(support) if room.quadrant == truth.quadrant]
    found = max((refined(room, support) for room in rooms), key=lambda room: score(room, support))
    assert score(found, support) >= 0.99 * score(truth, support)
    pixels = [corner_pixels(room, 0.3, 512) for room in (found, truth)]
    assert layout_scores(*pixels, 512, 256).iou_3d > 0.95  # a row is 2.8 degrees


def test_no_room_of_the_grid_is_better_than_the_one_that_the_search_returns():
    """Of four walls: against rooms drawn at random, in support without any order."""
    rng = np.random.default_rng(5)
    support = Support(*rng.random((2, 4, ROWS, COLUMNS)), np.zeros((ROWS + 1, COLUMNS)), 0.0, 0.0)
    best = score(best_rooms(support)[0], support)
    for _ in range(300):
        other = Hypothesis(None, tuple(rng.choice(DISTANCES, 4).tolist()), float(rng.choice(HEIGHTS)))
        assert score(other, support) <= best + 1e-9


@pytest.mark.parametrize("kind", ROOMS)
def test_visible_walls_are_those_that_rays_hit(kind):
    """Against the tracing of the same plan as a room of the world: X ahead, Y to the left."""
    plan = ROOMS[kind].corners()
    room = room_of_plan((plan * [1, -1])[::-1].tolist())
    azimuths = (np.arange(360) + 0.37) * 2 * np.pi / 360
    direction, away = visible_walls(plan, azimuths)
    ahead = np.column_stack([np.cos(azimuths), -np.sin(azimuths), np.zeros(360)])
    hits = first_hits(room, [0.0, 0.0, 1.0], ahead)
    assert away == pytest.approx(hits.distance)
    steps = np.roll(room.corners_w, -1, axis=0) - room.corners_w
    outward = np.column_stack([steps[:, 1], -steps[:, 0]])[hits.surface]  # counterclockwise: to the right
    expected = np.round(np.arctan2(-outward[:, 1], outward[:, 0]) / (np.pi / 2)).astype(int) % 4
    assert (direction == expected).all()


def test_corner_pixels_are_those_of_the_room_projected():
    plan = ROOMS["open"].corners() * 1.5
    room = room_of_plan((plan * [1, -1])[::-1].tolist(), height=1.5 + 0.9 * 1.5)
    pose = Pose.from_angles((0, 0, 1.5), yaw_deg=20)  # to the left: the heading comes to the right
    found = corner_pixels(ROOMS["open"], np.radians(20), 512)
    assert found == pytest.approx(cor_id(room, PANORAMA, pose), abs=1e-6)


@pytest.mark.parametrize("name", YAWS_DEG)
def test_the_heading_is_that_of_the_walls(shots, name):
    segments = line_segments(shots[name].lit)
    assert np.linalg.norm(segments.normals, axis=1) == pytest.approx(1)
    apart = (np.degrees(manhattan.heading(segments)) - YAWS_DEG[name] + 45) % 90 - 45
    assert abs(apart) < 360 / 512 / 2  # half a pixel


@pytest.mark.parametrize("name", YAWS_DEG)
def test_the_baseline_is_far_better_than_a_guess(shots, name):
    """The floors are what edges 2 px off, of 512, would have; the guess is a box around the camera, which
    shows where edges are in most rooms."""
    found = scores(Prediction(predict(shots[name].lit)), shots[name])
    guess = scores(Prediction(cor_id(room_of_plan(PLAIN), PANORAMA, pose_at(0.0))), shots[name])
    assert found["iou_3d"] > 0.85
    assert found["edges_f1"] > 0.7 > guess["edges_f1"] + 0.2
    assert found["corners_f1"] > 0.6 > guess["corners_f1"] + 0.2


def test_a_picture_without_lines_still_has_some_room():
    seen = evidence(np.full((64, 128, 3), 128, np.uint8), 64)
    assert not seen.lines.any()
    assert all(room.is_room() for room in best_rooms(edge_support(seen)))
