"""The doctor, with servers whose faults are known."""

import itertools
import re
from contextlib import contextmanager

import numpy as np
import pytest
from support.command_line import ROOT
from support.unreal import changed_depth, depth_like_legacy, field_of_view_80, relayed
from support.worlds import serve

import mock_server
import omniscv
from omniscv.cli import run
from omniscv.diagnostics import doctor, seams
from omniscv.diagnostics.moving import MovingWorld
from omniscv.diagnostics.server import RawCamera
from omniscv.geometry import Pose
from omniscv.sources import Request, View
from omniscv.sources.unreal.commands import FIX_EXPOSURE
from omniscv.sources.unreal.masks import colors, paint
from omniscv.sources.unreal.opening import open_connection


@contextmanager
def visited(*before, change=None, **options):
    """A connection to a server, after some commands, and a raw camera there that drops no frames."""
    with mock_server.serve("four-wall", **options) as server:
        relay = relayed(server, change or (lambda command, forward: forward(command)))
        with relay as uri, open_connection(uri, timeout_s=10) as connection:
            connection.texts(before)
            with RawCamera(connection) as camera:
                camera.lag = 0
                yield connection, camera


def examined(**options):
    """All that the doctor finds, by name."""
    with mock_server.serve("four-wall", **options) as server:
        return {finding.name: finding for finding in doctor.examine_address(server.uri)}


def motion(change=None, **options):
    """What the doctor finds about a world that moves, by name, and the server's world afterwards."""
    with serve(**{"time_step_s": 0.02, **options}) as server:
        relay = relayed(server, change or (lambda command, forward: forward(command)))
        with relay as uri, open_connection(uri) as connection:
            with RawCamera(connection) as camera:
                camera.lag = 0
                findings = MovingWorld(connection, camera).findings()
            return {finding.name: finding for finding in findings}, server.world


def light(*before, **options):
    """What the doctor finds about light and seams, by name."""
    with visited(*before, **options) as (_, camera):
        return {finding.name: finding for finding in seams.findings(seams.measure(camera))}


def bad(findings):
    """The names of what is bad."""
    return {name for name, finding in findings.items() if finding.verdict == "bad"}


def number(finding):
    """The first number in what was found."""
    return float(re.search(r"\d+(\.\d+)?", finding.value)[0])


def test_a_server_without_faults_is_ok():
    findings = examined()
    assert {finding.verdict for finding in findings.values()} == {"ok"}
    assert findings["dialect"].value.startswith("N3: plugin 1.1.0")
    assert findings["depth is"].value.startswith("planar")
    assert findings["depth unit"].value.startswith("cm")
    assert findings["depth steps"].value.startswith("float16")
    assert sum(name.startswith("seam ") for name in findings) == 12


def test_a_quick_look_leaves_out_seams_and_motion():
    """No finding warns of what needs nothing: recordings skip stale frames, and allow for fixed sizes."""
    with mock_server.serve("four-wall", dialect="0.3.10", size=(96, 96)) as server:
        findings = {each.name: each for each in doctor.examine_address(server.uri, quick=True)}
        served = server.statistics.total("vget /camera/0/lit png")
    assert {"dialect", "pose settles", "depth is", "mask colours"} <= findings.keys()
    assert not any(name.startswith("seam ") for name in findings)
    assert {each.verdict for each in findings.values()} == {"ok"}
    assert served <= 15


def test_a_folder_of_captures_is_examined_as_its_recording(tmp_path, capsys):
    assert (
        run(["recording", "export", str(ROOT / "captures" / "four-wall.sqlite"), str(tmp_path / "faces")])
        == 0
    )
    texts = []
    for path in (ROOT / "captures" / "four-wall.sqlite", tmp_path / "faces"):
        capsys.readouterr()
        assert run(["doctor", str(path), "--json"]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1]
    assert '"seams"' in texts[0]


def test_plugin_0_3_10_is_measured_by_its_depth_and_its_lag():
    findings = examined(dialect="0.3.10", size=(96, 96), depth="float32")
    assert not bad(findings)
    assert findings["depth is"].value.startswith("ray")
    assert findings["depth unit"].value.startswith("m;")
    assert findings["depth steps"].value.startswith("float32")
    assert findings["pose settles"].value.startswith("stale frames: 2")
    assert "not: points straight up" in findings["capabilities"].value


@pytest.mark.parametrize(
    ("window", "fov_deg", "says"), [((128, 96), 90, "up and down"), ((96, 96), 70, "70")]
)
def test_the_window_of_plugin_0_3_10_may_differ_from_the_camera(window, fov_deg, says):
    with visited(dialect="0.3.10", size=(96, 96), window=window, fov_deg=fov_deg) as (_, camera):
        camera.lag = 3
        pairs = doctor.turned_pairs(camera)
        assert doctor.sizes(pairs, camera).verdict == ("ok" if window == (96, 96) else "warning")
        assert doctor.field_of_view("lit", pairs, camera, "ray").verdict == "ok"
        mask = doctor.field_of_view("object_mask", pairs, camera, "ray")
        assert mask.verdict == "bad"
        assert says in mask.value


def test_a_field_of_view_is_measured_not_believed():
    """A server that reports 90 degrees, and captures 80."""
    with visited(change=field_of_view_80) as (_, camera):
        pairs = doctor.turned_pairs(camera)
        for mode in ("lit", "object_mask", "depth"):
            finding = doctor.field_of_view(mode, pairs, camera, "planar")
            assert finding.verdict == "bad"
            assert abs(number(finding) - 80) < 0.7  # a quarter of a pixel at the pictures' edge


@pytest.mark.parametrize("room", ["fence", "open"])
def test_thin_bars_and_an_even_ground_fit_many_fields_of_view(room):
    """A pair of pictures of these alone says nothing against a sound server."""
    with mock_server.serve(room) as server:
        findings = doctor.examine_address(server.uri, quick=True)
    assert [each for each in findings if each.verdict == "bad"] == []


def test_depth_is_measured_not_believed():
    """A server of plugin 1.x that sends what 0.3.10 sends: every recording from it would be wrong."""
    with visited(change=depth_like_legacy) as (_, camera):
        kind, meaning = doctor.depth_kind(doctor.turned_pairs(camera), camera)
        unit, scale = doctor.depth_unit(camera)
    assert (kind, unit) == ("ray", "m")
    assert meaning.verdict == scale.verdict == "bad"


def test_vignette_and_exposure_are_separated_and_measured():
    shaded, drifting = light(faults=["vignette=0.3"]), light(faults=["exposure-drift"])
    # The mock rounds to whole grey levels, about 0.5 % of what it shows.
    assert abs(number(shaded["vignette"]) - 30) < 0.5
    assert number(shaded["exposure"]) < 0.5
    assert drifting["exposure"].verdict == "bad"
    assert drifting["vignette"].verdict == "ok"


def test_the_remedies_make_every_seam_at_least_ten_times_smaller():
    faults = ["vignette", "exposure-drift"]
    before, after = light(faults=faults), light(*FIX_EXPOSURE, faults=faults)
    assert len(before) == 14
    assert bad(before) == set(before)
    assert not bad(after)
    for name in before:
        assert number(after[name]) <= number(before[name]) / 10


def test_seams_of_another_cause_have_another_remedy():
    seam = seams.findings(seams.Light({("front", "up"): 5.0}, vignette=0.0, exposure=0.0))[-1]
    assert seam.verdict == "bad"
    assert "r.BloomQuality 0" in seam.remedy


def test_the_windows_view_mode_gets_into_captures():
    with visited("vset /viewmode normal") as (connection, _):
        assert doctor.view_mode(connection).verdict == "bad"
        connection.texts([doctor.view_mode(connection).remedy])
        assert doctor.view_mode(connection).verdict == "ok"


@pytest.mark.parametrize("stale", [0, 3])
def test_stale_frames_are_counted(stale):
    with visited(faults=[f"stale={stale}"]) as (_, camera):
        finding = doctor.settle(camera)
        assert camera.lag == stale
    assert finding.verdict == "ok"


def test_a_camera_that_is_stuck_is_reported():
    with visited(faults=["stale=1000"]) as (_, camera):
        finding = doctor.settle(camera)
    assert finding.verdict == "bad"
    assert "does not turn" in finding.value


def test_a_world_that_moves_never_settles():
    frames = itertools.count()
    with visited(change=changed_depth(lambda depth: depth * (1 + 0.1 * next(frames)))) as (_, camera):
        assert doctor.settle(camera).verdict == "bad"


def test_mask_colours_that_show_alike_are_named():
    dark = ["vset /object/Table/color 0 0 10", "vset /object/Vase/color 0 12 0"]
    for faults, verdict in ((["mask-gamma"], "bad"), ([], "ok")):
        with visited(*dark, faults=faults) as (connection, camera):
            paint(connection, vertex_colors=False)
            before = colors(connection)
            finding = doctor.masks(connection, camera, doctor.turned_pairs(camera))
            assert finding.verdict == verdict
            assert ("background = Table = Vase" in finding.value) == (verdict == "bad")
            assert colors(connection) == before


def test_a_poor_connection_changes_no_finding():
    with (
        mock_server.serve("four-wall", seed=3) as server,
        open_connection(server.uri, timeout_s=0.4) as connection,
    ):
        with RawCamera(connection) as camera:
            camera.lag = 0
            server.faults.start("cut@0.03")
            pairs = doctor.turned_pairs(camera)
            assert doctor.depth_kind(pairs, camera)[1].verdict == "ok"
            paint(connection, vertex_colors=False)
            assert doctor.masks(connection, camera, pairs).verdict == "ok"
        assert server.faults.struck["cut"]


# Worlds that move.


@pytest.mark.parametrize("dialect", ["0.3.10", "N1"])
def test_a_world_that_moves_is_paused_and_left_as_it_was(dialect):
    findings, world = motion(dialect=dialect)
    assert findings["world moves"].value == "yes: Ball"
    assert findings["world moves"].verdict == "warning"
    assert findings["world pauses"].verdict == "ok"
    late = {"at once", "stale ticks: 1"} if dialect == "0.3.10" else {"at once"}
    assert findings["captures follow a move"].value in late
    assert not world.paused
    assert {name: each.location for name, each in world.objects.items() if name != "Ball"} == {
        "Box": (200.0, -50.0, 140.0),
        "Pole": (150.0, 160.0, 150.0),
    }


def test_a_world_that_moves_is_paused_for_what_else_is_measured():
    with (
        serve(time_step_s=0.1) as server,
        open_connection(server.uri) as connection,
        RawCamera(connection) as camera,
    ):
        world = MovingWorld(connection, camera)
        world.findings()
        with world.still():
            assert server.world.paused
            assert doctor.settle(camera).verdict == "ok"
        assert not server.world.paused


@pytest.mark.parametrize(("late", "verdict"), [(2, "ok"), (5, "bad")])
def test_ticks_are_counted_until_a_capture_shows_a_move(late, verdict):
    options = {"time_step_s": 0.0, "frames_per_s": 1.0}  # a request ends a frame, and nothing else does
    finding = motion(**options, faults=[f"late-objects={late}"])[0]["captures follow a move"]
    assert (finding.value, finding.verdict) == (f"stale ticks: {late}", verdict)


def test_a_world_that_cannot_be_paused_is_reported():
    moving, world = motion(faults=["ignore-pause"])
    assert moving["world pauses"].verdict == "bad"
    assert "Ball still moving" in moving["world pauses"].value
    assert not world.paused

    def refused(command, forward):
        return "error Argument Invalid" if "/action/game" in command else forward(command)

    findings, _ = motion(refused)
    assert findings["world pauses"].verdict == "warning"
    assert "Argument Invalid" in findings["world pauses"].value


def test_remedies_are_options_of_the_commands_that_capture(tmp_path):
    findings = {**light(faults=["vignette", "exposure-drift"]), **motion(dialect="N2")[0]}
    remedies = " ".join(finding.remedy for finding in findings.values())
    named = set(re.findall(r"(record )?(--\S+) ([\w.=]+)", remedies))
    assert {option for _, option, _ in named} == {"--set", "--overscan"}
    source = ["--source", "mock://four-wall", "--modes", "lit", "--set", "face_size=16"]
    for only, option, value in named:
        assert run(["record", *source, option, value, "--out", str(tmp_path / "room.sqlite")]) == 0
        if not only:
            assert run(["render", *source, option, value, "--size", "32x16", "--out", str(tmp_path)]) == 0


@pytest.mark.parametrize(
    ("dialect", "faults", "verdict"), [("N3", ["lit-normals"], "bad"), ("N3", [], "ok"), ("0.3.10", [], "ok")]
)
def test_normals_are_directions_or_the_lit_image(dialect, faults, verdict):
    with visited(dialect=dialect, faults=faults, size=(96, 96)) as (_, camera):
        assert doctor.normals(camera).verdict == verdict


def test_frames_that_blend_are_counted_and_dropped():
    """Half of the last image stays in each: the differences halve from frame to frame."""
    with mock_server.serve("four-wall", size=(48, 48), faults=["temporal=0.5"]) as server:
        with open_connection(server.uri) as connection, RawCamera(connection) as camera:
            camera.lag = 0
            finding = doctor.warm_up(camera)
        assert (finding.verdict, finding.name) == ("bad", "colours settle")
        count = int(number(finding))
        assert 4 <= count <= 8  # 8 bits
        assert finding.remedy == f"--set source_options.warmup={count}"
        errors = []
        for warmup in (0, count):
            with omniscv.open_source(server.uri, warmup=warmup) as source:
                views = [View(Pose.from_angles((0, 0, 1.5), yaw), 90.0, 48, 48) for yaw in (0, 90, 200)]
                captures = list(source.capture(Request(view, "lit") for view in views))
            with omniscv.open_source("mock://four-wall") as still:
                truth = list(still.capture(capture.request for capture in captures))
            off = [np.abs(a.pixels.astype(int) - b.pixels) for a, b in zip(captures, truth, strict=True)]
            errors.append(max(float(np.quantile(each, 0.99)) for each in off[1:]))
    assert errors[0] > 20
    assert errors[1] <= 2  # what remains of changes below a level, and rounding
