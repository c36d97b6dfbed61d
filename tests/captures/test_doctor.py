"""The doctor, before servers whose illness is known, and recordings with its cures."""

import dataclasses
import itertools
import json
import re
from contextlib import contextmanager

import numpy as np
import pytest

import mock_server
import omniscv
from mock_server import faulty_world, pictures
from mock_server.dialects.modern import Modern
from omniscv.captures.opening import open_link
from omniscv.captures.unreal import doctor, seams
from omniscv.captures.unreal.bare_camera import BareCamera
from omniscv.captures.unreal.live import CURES
from omniscv.captures.unreal.masks import colors, paint
from omniscv.cli import run

SPOILED = "mock://four-wall?fault=vignette&fault=exposure-drift"


@contextmanager
def visited(*before, **options):
    """A connection to a server, after some commands, and a bare camera there that waits for nothing."""
    with mock_server.serve("four-wall", **options) as server, open_link(server.uri, timeout_s=10) as link:
        link.texts(before)
        with BareCamera(link) as camera:
            camera.lag = 0
            yield link, camera


def examined(**options):
    """All that the doctor finds, by name."""
    with mock_server.serve("four-wall", **options) as server, open_link(server.uri, timeout_s=10) as link:
        return {finding.name: finding for finding in doctor.examine(link)}


def light(*before, **options):
    """What the doctor finds about light and seams, by name."""
    with visited(*before, **options) as (_, camera):
        return {finding.name: finding for finding in seams.findings(seams.measure(camera))}


def ill(findings):
    """The names of what is bad."""
    return {name for name, finding in findings.items() if finding.verdict == "bad"}


def number(finding):
    """The first number in what was found."""
    return float(re.search(r"\d+(\.\d+)?", finding.value)[0])


def test_a_server_without_faults_is_well():
    findings = examined()
    assert {finding.verdict for finding in findings.values()} == {"ok"}
    assert findings["dialect"].value.startswith("N1")
    assert findings["depth is"].value.startswith("planar")
    assert findings["depth unit"].value.startswith("cm")
    assert findings["depth steps"].value.startswith("float16")
    assert sum(name.startswith("seam ") for name in findings) == 12


def test_the_old_plugin_is_told_by_its_depth_and_its_lag():
    findings = examined(dialect="0.3.10", size=(96, 96), depth="float32")
    assert not ill(findings)
    assert findings["depth is"].value.startswith("ray")
    assert findings["depth unit"].value.startswith("m;")
    assert findings["depth steps"].value.startswith("float32")
    assert findings["pose settles"].value.startswith("late pictures: 2")
    assert "not: looks straight up" in findings["capabilities"].value


@pytest.mark.parametrize(
    ("window", "fov_deg", "says"), [((128, 96), 90, "up and down"), ((96, 96), 70, "70")]
)
def test_the_old_plugins_window_may_see_another_picture_than_the_camera(window, fov_deg, says):
    with visited(dialect="0.3.10", size=(96, 96), window=window, fov_deg=fov_deg) as (_, camera):
        camera.lag = 3
        looks = doctor.look_around(camera)
        assert doctor.sizes(looks, camera).verdict == ("ok" if window == (96, 96) else "warning")
        assert doctor.field_of_view("lit", looks, camera, "ray").verdict == "ok"
        mask = doctor.field_of_view("object_mask", looks, camera, "ray")
        assert mask.verdict == "bad"
        assert says in mask.value


def test_a_field_of_view_is_measured_not_believed(monkeypatch):
    """A server that says 90 degrees, and captures 80."""
    monkeypatch.setattr(faulty_world.World, "look", _narrow(faulty_world.World.look))
    with visited() as (_, camera):
        looks = doctor.look_around(camera)
        for mode in ("lit", "object_mask", "depth"):
            finding = doctor.field_of_view(mode, looks, camera, "planar")
            assert finding.verdict == "bad"
            assert abs(number(finding) - 80) < 0.7  # a quarter of a pixel at the pictures' edge


def _narrow(look):
    return lambda self, camera: look(self, dataclasses.replace(camera, fov=80.0))


def test_the_player_is_where_it_was_afterwards():
    asked = ["vget /camera/0/pose", "vget /camera/0/horizontal_fieldofview", "vget /viewmode"]
    with (
        mock_server.serve("four-wall", dialect="0.3.10", size=(64, 64)) as server,
        open_link(server.uri) as link,
    ):
        link.texts(["vset /camera/0/pose 10 20 130 5 40 0", "vset /camera/0/horizontal_fieldofview 70"])
        before = link.texts(asked)
        with BareCamera(link) as camera:
            camera.go(100, 30)
            camera.pixels("object_mask")
        assert link.texts(asked) == before


def test_depth_is_measured_not_believed(monkeypatch):
    """A server of plugin 1.x that sends what 0.3.10 sends: every recording from it would be wrong."""
    honest = Modern._pixels

    def ray_metres(self, view, mode):
        return pictures.stored(view.distance, half=True) if mode == "depth" else honest(self, view, mode)

    monkeypatch.setattr(Modern, "_pixels", ray_metres)
    with visited() as (_, camera):
        kind, meaning = doctor.depth_kind(doctor.look_around(camera), camera)
        unit, scale = doctor.depth_unit(camera)
    assert (kind, unit) == ("ray", "m")
    assert meaning.verdict == scale.verdict == "bad"


def test_vignette_and_exposure_are_told_apart_and_measured():
    shaded, drifting = light(faults=["vignette=0.3"]), light(faults=["exposure-drift"])
    # The mock rounds to whole grey levels, about 0.5 % of what it shows.
    assert abs(number(shaded["vignette"]) - 30) < 0.5
    assert number(shaded["exposure"]) < 0.5
    assert drifting["exposure"].verdict == "bad"
    assert drifting["vignette"].verdict == "ok"


def test_the_cures_make_every_seam_at_least_ten_times_smaller():
    faults = ["vignette", "exposure-drift"]
    before, after = light(faults=faults), light(*CURES, faults=faults)
    assert len(before) == 14
    assert ill(before) == set(before)
    assert not ill(after)
    for name in before:
        assert number(after[name]) <= number(before[name]) / 10


def test_seams_of_another_cause_have_another_cure():
    seam = seams.findings(seams.Light({("front", "up"): 5.0}, vignette=0.0, exposure=0.0))[-1]
    assert seam.verdict == "bad"
    assert "r.BloomQuality 0" in seam.cure


def test_the_windows_view_mode_gets_into_captures():
    with visited("vset /viewmode normal") as (link, _):
        assert doctor.view_mode(link).verdict == "bad"
        link.texts([doctor.view_mode(link).cure])
        assert doctor.view_mode(link).verdict == "ok"


@pytest.mark.parametrize("late", [0, 2, 3])
def test_late_pictures_are_counted(late):
    with visited(faults=[f"stale={late}"]) as (_, camera):
        finding = doctor.settle(camera)
        assert camera.lag == late
    assert finding.verdict == ("warning" if late else "ok")


def test_a_camera_that_is_stuck_is_told():
    with visited(faults=["stale=1000"]) as (_, camera):
        finding = doctor.settle(camera)
    assert finding.verdict == "bad"
    assert "does not turn" in finding.value


def test_a_world_that_moves_never_settles(monkeypatch):
    honest, pictures_taken = pictures.stored, itertools.count()
    monkeypatch.setattr(
        pictures, "stored", lambda depth, half: honest(depth * (1 + 0.1 * next(pictures_taken)), half)
    )
    with visited() as (_, camera):
        assert doctor.settle(camera).verdict == "bad"


def test_mask_colours_that_show_alike_are_named():
    dark = ["vset /object/Table/color 0 0 10", "vset /object/Vase/color 0 12 0"]
    for faults, verdict in ((["mask-gamma"], "bad"), ([], "ok")):
        with visited(*dark, faults=faults) as (link, camera):
            paint(link)
            before = colors(link)
            finding = doctor.masks(link, camera, doctor.look_around(camera))
            assert finding.verdict == verdict
            assert ("background = Table = Vase" in finding.value) == (verdict == "bad")
            assert colors(link) == before


@pytest.mark.parametrize("fault", ["reset@0.03", "cut@0.03"])
def test_a_poor_connection_changes_no_finding(fault):
    with mock_server.serve("four-wall", seed=3) as server, open_link(server.uri, timeout_s=0.4) as link:
        with BareCamera(link) as camera:
            camera.lag = 0
            server.faults.start(fault)
            looks = doctor.look_around(camera)
            assert doctor.depth_kind(looks, camera)[1].verdict == "ok"
            paint(link)
            assert doctor.masks(link, camera, looks).verdict == "ok"
        assert server.faults.struck[fault.partition("@")[0]]


# Recordings with the cures.


def near_seams(width, height):
    """(H, W) the pixels of an equirectangular image within two degrees of an edge of the cube."""
    longitude = (0.5 - (np.arange(width) + 0.5) / width)[None, :] * 2 * np.pi
    latitude = (0.5 - (np.arange(height) + 0.5) / height)[:, None] * np.pi
    along = np.sort(
        np.abs([
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude) * np.ones_like(longitude),
        ]),
        axis=0,
    )  # fmt: skip
    return np.degrees(np.arctan2(along[2], along[1])) - 45 < 2


def composed(path, uri, *options):
    """A panorama from a recording of the six faces."""
    arguments = ["record", "--source", uri, "--face-size", "64", "--modes", "lit", "--out", str(path)]
    assert run([*arguments, *options]) == 0
    camera = omniscv.cameras.create("equirectangular", width=256, height=128)
    with omniscv.open_source(path) as source:
        image = omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source, face_size=64)
    return image.layers.lit.astype(float)


@pytest.fixture(scope="module")
def true(tmp_path_factory):
    """From a server without faults."""
    return composed(tmp_path_factory.mktemp("true") / "faces.sqlite", "mock://four-wall")


@pytest.mark.parametrize(
    ("uri", "options"),
    [
        (SPOILED, ["--fix-exposure"]),
        (SPOILED, ["--fix-exposure", "--overscan", "8"]),
        # 160 px beyond faces of 64: an edge's middle is where (32 / 192)^2 of the corners' loss is.
        ("mock://four-wall?fault=vignette", ["--overscan", "160"]),
    ],
    ids=["exposure", "both", "overscan"],
)
def test_recordings_with_the_cures_have_a_tenth_of_the_seam_error(uri, options, true, tmp_path):
    """The error along the edges of the cube."""
    near = near_seams(256, 128)
    before = np.abs(composed(tmp_path / "before.sqlite", uri) - true)[near].mean()
    after = np.abs(composed(tmp_path / "after.sqlite", uri, *options) - true)[near].mean()
    print(f"{' '.join(options)}: {before:.2f} grey levels before, {after:.2f} after")
    assert before > 15
    assert after <= before / 10


# The command.


def test_the_command_prints_json_and_tells_by_its_exit_code(capsys):
    assert run(["doctor", "mock://four-wall?dialect=M&fault=vignette=0.3", "--json"]) == 1
    findings = {each["name"]: each for each in json.loads(capsys.readouterr().out)}
    assert findings["vignette"]["verdict"] == "bad"
    assert "r.Tonemapper.Quality 1" in findings["vignette"]["cure"]
    assert run(["doctor", "mock://six-wall?dialect=N2", "--position", "0.5,0,1.4"]) == 0
    assert "seam right|down" in capsys.readouterr().out


@pytest.mark.parametrize("address", ["room.sqlite", "http://localhost", "unreal://"])
def test_only_servers_are_examined(address, capsys):
    assert run(["doctor", address]) == 2
    assert "expected unreal://host:port" in capsys.readouterr().err
