"""What the doctor finds where captures contradict each other, or what the server says of its objects."""

import pytest

import mock_server
from omniscv.diagnostics import agreement
from omniscv.diagnostics.server import RawCamera
from omniscv.sources.unreal.boxes import boxes
from omniscv.sources.unreal.masks import colors
from omniscv.sources.unreal.opening import open_connection


def bad(*faults, scene="four-wall", **options):
    """The names of what does not agree, and the text of it."""
    with (
        mock_server.serve(scene, faults=faults, seed=2, **options) as server,
        open_connection(server.uri, timeout_s=30) as connection,
        RawCamera(connection) as camera,
    ):
        camera.lag = 3 if options else 0
        table = colors(connection)
        findings = agreement.findings(camera, table, boxes(connection, list(table)))
        return {each.name: each.value for each in findings if each.verdict != "ok"}


@pytest.mark.parametrize("scene", ["four-wall", "six-wall", "open"])
def test_captures_of_a_sound_server_agree(scene):
    assert bad(scene=scene) == {}


def test_things_thinner_than_a_pixel_come_and_go():
    """Wires of 3 mm, and rods of 20 mm."""
    assert bad(scene="fence").keys() == {"things that come and go"}


def test_captures_of_the_old_plugin_agree():
    assert bad(dialect="0.3.10", size=(128, 128)) == {}


@pytest.mark.parametrize(
    ("fault", "scene", "name", "value"),
    [
        ("exposure-drift=0.01", "four-wall", "same again", "colours"),
        ("jitter=0.5", "four-wall", "same again", "of depth"),
        ("moving-world=0.001", "four-wall", "same again", "of depth"),
        ("turned=1", "four-wall", "depth, turned", "disagrees"),
        ("radial-depth=0.1", "four-wall", "depth, turned", "disagrees"),
        ("far-plane=2", "four-wall", "depth, turned", "disagrees"),
        ("depth-bits=12", "four-wall", "depth, turned", "disagrees"),
        ("depth-mantissa", "four-wall", "depth, turned", "disagrees"),
        ("distortion=0.05", "four-wall", "depth, turned", "disagrees"),
        ("far-origin=1000", "four-wall", "depth, moved", "disagrees"),
        ("near-plane=100", "four-wall", "things that come and go", "looks through"),
        ("depth-scale=0.01", "six-wall", "depth scale", "+"),
        ("mask-noise=3", "four-wall", "same again", "of masks"),
        ("vignette=0.3", "four-wall", "colours, turned", "disagree"),
        ("lit-offset=1", "six-wall", "colours over masks", "1 px right"),
        ("gloss=Picture", "four-wall", "colours that depend on the view", "Picture"),
        ("glass=Sofa", "four-wall", "objects where they should be", "Sofa is not shown"),
        ("sky-dome=100", "open", "domes", "SkyDome at 100 m"),
    ],
)
def test_what_contradicts_is_found(fault, scene, name, value):
    assert value in bad(fault, scene=scene).get(name, "")
