"""Each fault of the mock server, dialect N3, and the finding of the doctor that names it."""

import re

import pytest
from support.worlds import SCENE

import mock_server
from mock_server.faults import KINDS
from omniscv.diagnostics import doctor, seams, server
from omniscv.diagnostics.moving import MovingWorld
from omniscv.diagnostics.server import RawCamera
from omniscv.errors import ServerRefusedError
from omniscv.sources.unreal.masks import paint
from omniscv.sources.unreal.opening import open_connection

EDGE = 64


def turned(connection, camera):
    """What two pictures say, before and after a turn."""
    pairs = doctor.turned_pairs(camera)
    kind, meaning = doctor.depth_kind(pairs, camera)
    return [doctor.field_of_view("depth", pairs, camera, kind), meaning, doctor.half_floats(pairs, "cm")]


def masks(connection, camera):
    paint(connection, vertex_colors=False)
    return [doctor.masks(connection, camera, doctor.turned_pairs(camera))]


PARTS = {
    "settle": lambda connection, camera: [doctor.settle(camera)],
    "warm up": lambda connection, camera: [doctor.warm_up(camera)],
    "normals": lambda connection, camera: [doctor.normals(camera)],
    "turned": turned,
    "unit": lambda connection, camera: [doctor.depth_unit(camera)[1]],
    "masks": masks,
    "seams": lambda connection, camera: seams.findings(seams.measure(camera)),
    "motion": lambda connection, camera: MovingWorld(connection, camera).findings(),
}
NAMED = [
    ("stale=1000", "settle", "pose settles", "the camera does not turn"),
    ("ignore-pose", "settle", "pose settles", "the camera does not turn"),
    ("moving-world", "settle", "pose settles", "the world moves"),
    ("temporal", "warm up", "colours settle", "temporal effects"),
    ("lit-normals", "normals", "normals", "the lit image"),
    ("narrow-fov", "turned", "field of view, depth", "90.0 reported"),
    ("ray-depth", "turned", "depth is", "ray"),
    ("half-depth", "turned", "depth steps", "float16"),
    ("depth-scale=0.1", "unit", "depth unit", "neither cm nor m"),
    ("near-colors", "masks", "mask colours", "of no object"),
    ("mask-blur=2", "masks", "mask colours", "of no object"),
    ("jpeg", "masks", "mask colours", "of no object"),
    ("exposure-drift", "seams", "exposure", "between pictures"),
    ("vignette", "seams", "vignette", "corners"),
    ("bloom=0.5", "seams", "seam left|down", "levels"),
    ("late-objects=7", "motion", "captures follow a move", "stale ticks: "),
    ("ignore-pause", "motion", "world pauses", "Ball still moving"),
]
REFUSED = [("refuse-mask", "Captured data is empty"), ("authentication", "Authentication required")]
CONTRADICTIONS = """jitter turned radial-depth far-plane far-origin near-plane mask-noise lit-offset gloss
    glass sky-dome depth-bits depth-mantissa distortion"""  # in test_agreement.py
CONNECTION = """delay drip missing wrong-id no-id clicked cut bad-magic zero-size huge reset no-greeting
    second-client"""  # requests are sent again
HARMLESS = {
    "put right before it is measured, by the colours that recordings set": "object-missing mask-gamma",
    "of the player's camera, which the doctor leaves alone": "falling",
    "of exposure by hand, which the doctor does not set": "dark-manual",
    "of cine models, which a spawned camera has switched off": "stretched-cine",
    "of brightness alone: as likely the artist's wish": "tone",
    "of captures in a world that moves, which is paused": "torn",
}
HARMLESS_NAMES = " ".join(HARMLESS.values()).split()


def findings(part, *faults):
    """What a part of the doctor finds in a room, or in the yard where something moves, by name."""
    scene, options = ("four-wall", {}) if part != "motion" else (SCENE, {"time_step_s": 0.02})
    options |= {"size": (EDGE, EDGE), "depth": "float32", "seed": 2}
    if part == "motion":
        options["frames_per_s"] = 2000
    with (
        mock_server.serve(scene, dialect="N3", faults=faults, **options) as served,
        open_connection(served.uri) as connection,
        RawCamera(connection) as camera,
    ):
        camera.lag = 0
        return {finding.name: finding for finding in PARTS[part](connection, camera)}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(server, "EDGE_PX", EDGE)


@pytest.mark.parametrize("part", PARTS)
def test_without_a_fault_nothing_is_named(part):
    found = findings(part)
    texts = {(name, text) for _, where, name, text in NAMED if where == part}
    assert texts
    for name, text in texts:
        assert found[name].verdict == "ok" or text not in found[name].value


@pytest.mark.parametrize(("fault", "part", "name", "text"), NAMED)
def test_a_fault_is_named(fault, part, name, text):
    finding = findings(part, fault)[name]
    assert text in finding.value
    assert finding.verdict == ("ok" if fault == "half-depth" else "bad")


@pytest.mark.parametrize(("fault", "text"), REFUSED)
def test_a_server_that_refuses_is_not_measured(fault, text):
    with (
        mock_server.serve("four-wall", size=(EDGE, EDGE), faults=[fault]) as served,
        pytest.raises(ServerRefusedError, match=text),
    ):
        doctor.examine_address(served.uri, quick=True)


def test_what_spoils_no_capture_is_not_named():
    with mock_server.serve("four-wall", size=(EDGE, EDGE), faults=HARMLESS_NAMES) as served:
        found = doctor.examine_address(served.uri, quick=True)
    assert {finding.verdict for finding in found} == {"ok"}


def test_every_fault_of_the_mock_has_its_place():
    named = [re.split("=", row[0])[0] for row in (*NAMED, *REFUSED)]
    listed = [*named, *CONTRADICTIONS.split(), *CONNECTION.split(), *HARMLESS_NAMES]
    assert sorted(listed) == sorted(KINDS)
