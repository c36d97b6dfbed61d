"""The doctor, before servers whose illness is known, and recordings with its cures."""

import json
import re

import numpy as np
import pytest

import mock_server
import omniscv
from mock_server import pictures
from mock_server.dialects.modern import Modern
from omniscv.captures.opening import open_link
from omniscv.captures.unreal import seams
from omniscv.captures.unreal.bare_camera import BareCamera
from omniscv.captures.unreal.doctor import examine
from omniscv.captures.unreal.live import CURES
from omniscv.cli import run

SPOILED = "mock://four-wall?fault=vignette&fault=exposure-drift"


def examined(*before, scene="four-wall", **options):
    """What the doctor finds, by name, after some commands."""
    with mock_server.serve(scene, **options) as server, open_link(server.uri, timeout_s=10) as link:
        link.texts(before)
        return {finding.name: finding for finding in examine(link)}


def ill(findings):
    """The names of what is bad."""
    return {name for name, finding in findings.items() if finding.verdict == "bad"}


def number(finding):
    """The first number in what was found."""
    return float(re.search(r"\d+(\.\d+)?", finding.value)[0])


@pytest.mark.parametrize("dialect", ["M", "N1", "N2"])
def test_a_server_without_faults_is_well(dialect):
    findings = examined(dialect=dialect)
    assert {finding.verdict for finding in findings.values()} == {"ok"}
    assert findings["dialect"].value.startswith(dialect)
    assert findings["depth is"].value.startswith("planar")
    assert findings["depth unit"].value.startswith("cm")
    assert findings["depth steps"].value.startswith("float16")
    assert sum(name.startswith("seam ") for name in findings) == 12


def test_the_old_plugin_is_told_by_its_depth_and_its_lag():
    findings = examined(dialect="0.3.10", size=(128, 128), depth="float32")
    assert not ill(findings)
    assert findings["depth is"].value.startswith("ray")
    assert findings["depth unit"].value.startswith("m;")
    assert findings["depth steps"].value.startswith("float32")
    assert findings["pose settles"].value.startswith("after 2 late pictures")
    assert "not: looks straight up" in findings["capabilities"].value


def test_the_old_plugins_window_may_see_another_picture_than_the_camera():
    findings = examined(dialect="0.3.10", size=(128, 128), window=(160, 120))
    assert findings["picture size"].verdict == "warning"
    assert "object_mask 160 x 120" in findings["picture size"].value
    assert ill(findings) == {"field of view, mask"}  # 90 degrees across are 74 up and down


def test_the_player_is_where_it_was_afterwards():
    asked = ["vget /camera/0/pose", "vget /camera/0/horizontal_fieldofview", "vget /viewmode"]
    with mock_server.serve("four-wall", dialect="0.3.10", size=(64, 64)) as server:
        with open_link(server.uri) as link:
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
    findings = examined()
    assert {"depth is", "depth unit"} <= ill(findings)
    assert findings["depth is"].value.startswith("ray")
    assert findings["depth unit"].value.startswith("m;")


def test_vignette_and_exposure_are_told_apart_and_measured():
    shaded = examined(faults=["vignette=0.3"])
    assert number(shaded["exposure"]) < 0.2
    # The mock rounds to whole grey levels, about 0.5 % of what it shows.
    assert abs(number(shaded["vignette"]) - 30) < 0.5
    drifting = examined(faults=["exposure-drift"])
    assert drifting["exposure"].verdict == "bad"
    assert drifting["vignette"].verdict == "ok"


def test_late_pictures_are_counted():
    findings = examined(faults=["stale=2"])
    assert findings["pose settles"].value.startswith("after 2 late pictures")
    assert not ill(findings)


def test_mask_colours_that_show_alike_are_named():
    set_dark = ["vset /object/Table/color 0 0 10", "vset /object/Vase/color 0 12 0"]
    findings = examined(*set_dark, faults=["mask-gamma"])
    assert ill(findings) == {"mask colours"}
    assert "background = Table = Vase" in findings["mask colours"].value
    assert not ill(examined(*set_dark))  # where colours show as they are set


def test_the_cures_make_every_seam_at_least_ten_times_smaller():
    faults = ["vignette", "exposure-drift"]
    before, after = examined(faults=faults), examined(*CURES, faults=faults)
    names = ["seam " + "|".join(pair) for pair in seams.EDGES]
    assert {"exposure", "vignette", *names} == ill(before)
    assert not ill(after)
    for name in names:
        assert number(after[name]) <= number(before[name]) / 10


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


@pytest.mark.parametrize(
    ("uri", "options"),
    [
        (SPOILED, ["--fix-exposure"]),
        # 160 px beyond faces of 64: an edge's middle is where (32 / 192)^2 of the corners' loss is.
        ("mock://four-wall?fault=vignette", ["--overscan", "160"]),
        (SPOILED, ["--fix-exposure", "--overscan", "8"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_recordings_with_the_cures_have_a_tenth_of_the_seam_error(uri, options, tmp_path):
    """Against a recording from a server without faults, along the edges of the cube."""
    near = near_seams(256, 128)
    true = composed(tmp_path / "true", "mock://four-wall")
    before = np.abs(composed(tmp_path / "before", uri) - true)[near].mean()
    after = np.abs(composed(tmp_path / "after", uri, *options) - true)[near].mean()
    assert before > 20  # grey levels
    assert after <= before / 10


# The command.


def test_the_command_prints_json_and_tells_by_its_exit_code(capsys):
    assert run(["doctor", "mock://four-wall?fault=vignette=0.3", "--json"]) == 1
    findings = {each["name"]: each for each in json.loads(capsys.readouterr().out)}
    assert findings["vignette"]["verdict"] == "bad"
    assert "r.Tonemapper.Quality 1" in findings["vignette"]["cure"]
    assert run(["doctor", "mock://six-wall", "--position", "0.5,0,1.4"]) == 0
    assert "seam right|down" in capsys.readouterr().out


@pytest.mark.parametrize("address", ["room.sqlite", "http://localhost", "unreal://"])
def test_only_servers_are_examined(address, capsys):
    assert run(["doctor", address]) == 2
    assert "expected unreal://host:port" in capsys.readouterr().err
