"""The edges of a room from one non-central image, against the room."""

import numpy as np
import pytest
from support.rooms import room_of_scene
from support.traced_frames import traced

import mock_server
import omniscv
from omniscv.errors import ArgumentError
from omniscv.evaluate import Settings, run
from omniscv.evaluate import lines as lines
from omniscv.evaluate.lines import boundary, room_edges, seen_edges


def test_boundaries_lie_between_the_pixels_of_two_labels():
    labels = np.array([[1, 1, 2, 2], [1, 3, 3, 2], [1, 1, 1, 2]], np.uint16)
    assert sorted(map(tuple, boundary(labels, 1, 2))) == [(2.0, 0.5), (3.0, 2.5)]
    assert sorted(map(tuple, boundary(labels, 3, 1))) == [(1.0, 1.5), (1.5, 1.0), (1.5, 2.0), (2.5, 2.0)]
    assert len(boundary(labels, 1, 4)) == 0


@pytest.fixture(scope="module")
def shot():
    """The paper's panorama, half as fine."""
    camera = omniscv.cameras.create("noncentral-panorama", width=1024, height=512, radius=1.0)
    return lines.Setup("panorama-1", camera, omniscv.Pose.from_angles((0, 0, 1.5), 20, 10, 0))


@pytest.fixture(scope="module")
def seen(shot):
    """The edges that its exact labels show."""
    with omniscv.open_source("scene://four-wall") as source:
        room, names = source.geometry().room, source.objects().names()
    labels = traced(mock_server.load_scene("four-wall"), shot.camera, shot.pose)["labels"]
    return seen_edges(room, shot.camera, labels, names)


@pytest.fixture(scope="module")
def rows(seen, shot):
    """The errors of the lines that those of the room give."""
    return list(lines.score(seen, lines.reconstruct(seen, shot), shot))


def of(rows, **wanted):
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def test_an_edges_pixels_are_on_its_image(seen, shot):
    for edge, observed in seen:
        assert observed.rms_px(edge.line_c(shot.pose)) <= 0.75, edge


@pytest.mark.parametrize("prior", ["free", "gravity", "Manhattan"])
def test_edges_of_sufficient_baseline_are_near_the_truth(rows, prior):
    """Vertical ones within 3 cm, unless free; horizontal ones within 2 degrees and 10 cm."""
    vertical = [row for row in of(rows, prior=prior, kind="vertical") if row["baseline_m"] >= 0.05]
    assert len(vertical) == 2
    assert prior == "free" or max(row["distance_m"] for row in vertical) <= 0.03
    horizontal = [row for row in of(rows, prior=prior, kind="horizontal") if row["baseline_m"] >= 0.4]
    assert len(horizontal) >= 2
    assert max(row["distance_m"] for row in horizontal) <= 0.1
    assert max(row["direction_deg"] for row in horizontal) <= 2


def test_every_edge_is_seen_and_priors_reduce_the_errors(rows):
    assert len(of(rows, prior="free")) == 12
    assert len(of(rows, prior="free", kind="vertical")) == 4

    def median(prior):
        return np.median([row["distance_m"] for row in of(rows, prior=prior)])

    assert median("Manhattan") <= median("gravity") < 0.5 * median("free")


@pytest.mark.parametrize("scene", ["four-wall", "six-wall"])
def test_exact_points_of_the_rooms_edges_give_them_exactly(scene):
    room = room_of_scene(scene)
    panorama = omniscv.cameras.create("noncentral-panorama", 2048, 1024, radius=1.0)
    cone = omniscv.cameras.create("noncentral-conical-mirror", 1024, 1024, half_angle_deg=55, distance=0.5)
    for camera, *angles in ((panorama, 20, 10, 0), (panorama, 130, 8, -6), (cone, 20, 80, 0)):
        shot = lines.Setup("", camera, omniscv.Pose.from_angles((0, 0, 1.2), *angles))
        distances = [off for baseline, off in lines.exact_errors(room, shot) if baseline >= 0.05]
        assert len(distances) >= 2
        assert max(distances) <= 1e-9


def test_edges_of_an_l_shaped_room_go_once_around():
    edges = list(room_edges(room_of_scene("six-wall")))
    assert [edge.kind for edge in edges].count("vertical") == 6
    assert len({edge.surfaces for edge in edges}) == len(edges) == 18
    ends = np.array([edge.ends_w for edge in edges]).reshape(-1, 3)
    corners, times = np.unique(np.round(ends, 9), axis=0, return_counts=True)
    assert len(corners) == 12
    assert set(times.tolist()) == {3}


def test_a_source_without_a_room_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="source: expected one with a known room, got none"):
        run("lines", Settings(tmp_path, quick=True, source="scene://direction"))
