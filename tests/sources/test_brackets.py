"""Colours at several exposures, merged to light: against the light of the scene itself."""

from dataclasses import replace

import numpy as np
import pytest

import omniscv
from mock_server import load_scene
from omniscv import light
from omniscv.cameras import create
from omniscv.cli import run
from omniscv.compose.files import read
from omniscv.errors import ArgumentError, BadReplyError, SourceError
from omniscv.job.file import load
from omniscv.make import costs, make
from omniscv.sources import Request, SourceWrapper, View, bracketed, brackets, registry
from omniscv.sources.recording import RecordedSource
from omniscv.sources.scene import SceneSource

POSE = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=10)
CAMERA = create("equirectangular", width=32, height=16)
STOPS = (-2, 0, 2)
CURVES = {
    "srgb": lambda x: 255 * light.light_to_srgb(x),
    "film": lambda x: 255 * light.light_to_srgb(light.film_curve(x)),
    "gamma": lambda x: 255 * np.clip(x, 0, 1) ** (1 / 3.2),
}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A quarter of the pixels that the exposure is tried with, and of those that must be of use."""
    monkeypatch.setattr(brackets, "_PROBED_PX", 64)
    monkeypatch.setattr(brackets, "_FEWEST", 25)


class Exposing(SourceWrapper):
    """Scenes in 8 bits, at whatever exposure is requested.

    Args:
        curve: from light to codes.
        scale: of light; 3 makes colours brighter than white.
        doubles: of each stop; 1 for a server that does what it is told.
    """

    def __init__(self, curve="srgb", transfer="unknown", scale=3.0, doubles=1.0):
        super().__init__(SceneSource(load_scene("four-wall"), lit="float32"))
        self.curve = CURVES[curve]
        self.transfer = transfer
        self.scale = scale
        self.doubles = doubles
        self.made = []

    @property
    def capabilities(self):
        return replace(super().capabilities, transfer=self.transfer, can_set_exposure=True)

    def capture(self, requests):
        for each in super().capture(requests):
            self.made.append(each.request)
            if each.mode == "lit":
                exposure = 2.0 ** (self.doubles * (each.request.stops or 0))
                shown = self.curve(self.scale * each.pixels * exposure)
                each = replace(each, pixels=np.clip(np.rint(shown), 0, 255).astype(np.uint8))
            yield each


def due(scale=3.0):
    with SceneSource(load_scene("four-wall"), lit="float32") as source:
        return scale * omniscv.render(CAMERA, POSE, source, face_size=32, filter="nearest").lit


def rendered(source):
    return omniscv.render(CAMERA, POSE, source, ("lit", "depth"), face_size=32, filter="nearest")


@pytest.mark.parametrize(("curve", "transfer"), [("srgb", "srgb"), ("film", "unknown")])
def test_the_light_of_a_scene_is_merged(curve, transfer):
    """As light.md bounds it: within .94 % where a step is two stops; film is steeper, and nearly as exact."""
    with bracketed(Exposing(curve, transfer), STOPS) as source:
        image = rendered(source)
    assert (image.lit.dtype, image.transfer) == (np.float32, "linear")
    seen = due() > 0.02
    assert image.lit[seen].max() > 1.5
    assert np.abs(image.lit[seen] / due()[seen] - 1).max() < 0.02


def test_a_recording_keeps_exposures_and_merges_them_when_it_is_replayed(tmp_path):
    path = tmp_path / "room.sqlite"
    live = Exposing("gamma")
    with bracketed(live, STOPS, path) as source:
        image = rendered(source)
    ratio = (image.lit / due())[due() > 0.05]  # light up to its unit, as the response is not known
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.02
    counted = [request.stops for request in live.made if not request.again]
    assert [counted.count(stops) for stops in (*STOPS, None)] == [6, 6, 6, 6]  # faces; depth has none
    with omniscv.record(Exposing("gamma"), path) as source:
        rendered(source)  # at the source's own exposure: no light
    with omniscv.open_source(path) as source:
        assert (source.capabilities.transfer, source.stops) == ("linear", STOPS)
        replayed = rendered(source)
        codes = [next(source.capture([replace(live.made[-1], mode="lit", stops=s)])).pixels for s in STOPS]
    np.testing.assert_array_equal(replayed.lit, image.lit)
    np.testing.assert_array_equal(replayed.depth, image.depth)
    assert [each.dtype for each in codes] == [np.uint8] * 3


def test_recording_goes_on_with_its_response_and_stops(tmp_path):
    path = tmp_path / "room.sqlite"
    for turn, tried in ((0, True), (0, False), (4, False)):
        with bracketed(live := Exposing("gamma"), STOPS, path) as source:
            omniscv.render(CAMERA, replace(POSE, rotation=POSE.rotation), source, face_size=16 + turn)
        assert any(request.again for request in live.made) is tried
    with RecordedSource(path) as source:
        assert len(source.response()) == 256
    with pytest.raises(ArgumentError, match=r"brackets: expected -2, 0, 2, the stops of .*; got 0, 1"):
        bracketed(Exposing("gamma"), (0, 1), path)


def test_a_server_that_does_not_expose_as_it_is_set_is_refused():
    for live, got in (
        (Exposing("srgb", "srgb", doubles=0.0), "1 times as much"),
        (Exposing("srgb", "unknown", doubles=0.0), "1 times as much"),
        (Exposing("srgb", "srgb", doubles=0.5), r"1\.4\d times as much"),
        (Exposing("film", "srgb"), "times as much"),
        (Exposing("srgb", "srgb", scale=1e-3), "too few samples of codes 30 to 200"),
    ):
        with bracketed(live, STOPS) as source, pytest.raises(SourceError, match=got):
            rendered(source)


def test_exposures_that_cannot_be_merged_or_set_are_refused(tmp_path):
    view = View(POSE, 90, 8, 8)
    floats = SceneSource(load_scene("four-wall"), lit="float32")
    for live, error, says in (
        (Exposing(), ArgumentError, "transfer: expected one of srgb, linear, film; got None"),
        (floats, BadReplyError, "of one size in 8 bits, got .*float32"),
    ):
        path = tmp_path / f"{error.__name__}.sqlite"
        with omniscv.record(live, path) as source:  # without bracketed
            list(source.capture(Request(view, "lit", stops=stops) for stops in STOPS))
        with omniscv.open_source(path) as source, pytest.raises(error, match=says):
            list(source.capture([Request(view, "lit")]))
    refused = pytest.raises(ArgumentError, match="brackets: expected a source whose exposure can be set")
    with omniscv.open_source("scene://four-wall") as source, refused:
        bracketed(source, STOPS)


@pytest.fixture
def exposing(monkeypatch):
    monkeypatch.setitem(registry._openers, "exposing", lambda address: Exposing())
    return "exposing://room"


def test_a_command_records_them_and_a_job_composes_light(exposing, tmp_path, capsys):
    path = tmp_path / "room.sqlite"
    words = f"record --source {exposing} --position 0,0,1.5 --modes lit,depth --out {path}".split()
    words += ["--brackets", "-2,0,2", "--set", "face_size=32", "--set", "cameras.cube.width=32"]
    for new in ("24 captures", "24 captures, none new"):
        assert run([*words, "--set", "cameras.cube.height=16"]) == 0
        assert capsys.readouterr().out.strip().endswith(new)
    keys = {
        "source": str(path), "cameras": {"eye": {"model": "equirectangular", "width": 32, "height": 16}},
        "poses": [{"position": [0, 0, 1.5], "yaw_deg": 10}], "modes": ["lit", "depth"], "face_size": 32,
        "filter": "nearest", "sensor": {"electrons": 1e9, "full_well": 1e9, "bits": 16},
    }  # fmt: skip
    make(load(keys | {"out": str(tmp_path / "replayed")}))
    make(load(keys | {"source": exposing, "brackets": [-2, 0, 2], "out": str(tmp_path / "live")}))
    lit, again = (read(tmp_path / name / "eye.lit.exr", "lit") for name in ("replayed", "live"))
    np.testing.assert_array_equal(lit, again)
    seen = due() > 0.02
    assert np.abs(lit[seen] / due()[seen] - 1).max() < 0.02
    shown = read(tmp_path / "live" / "eye.sensor.png", "sensor")
    assert np.abs(shown - np.rint(255 * light.light_to_srgb(np.minimum(lit, 1)))).max() <= 1
    again = load(keys | {"source": exposing, "brackets": [0, 2], "out": str(tmp_path / "live")})
    with pytest.raises(ArgumentError, match=r"options\.brackets"):
        make(again, existing="resume")


@pytest.mark.parametrize("stops", [[0], [2, 0], [0, 0], [0, 30], "0,2", 3])
def test_other_stops_are_refused(stops):
    keys = {"source": "mock://four-wall", "poses": [{"position": [0, 0, 1]}], "brackets": stops}
    with pytest.raises(ArgumentError, match="brackets: expected two or more increasing stops within 20"):
        load(keys)


def test_a_plan_counts_every_exposure():
    keys = {
        "source": "mock://four-wall?dialect=N2", "poses": [{"position": [0, 0, 1]}],
        "modes": ["lit", "depth"],
        "cameras": {"eye": {"model": "equirectangular", "width": 32, "height": 16}}, "face_size": 16,
    }  # fmt: skip
    for stops, count in (([], 12), ([-2, 0, 2], 24)):
        (cube,) = (row for row in costs(load(keys | {"brackets": stops})) if row.way == "cube")
        assert cube.requests == count
