"""The doctor: sound servers, and every fault of the mock server with the finding that names it."""

import re
from contextlib import contextmanager

import numpy as np
import pytest
from support.unreal import answering, relayed
from support.worlds import SCENE, serve

import mock_server
import omniscv
from mock_server.faults import KINDS
from omniscv.cli import run
from omniscv.diagnostics import agreement, doctor, server
from omniscv.diagnostics.server import MovingWorld, RawCamera
from omniscv.errors import ServerRefusedError
from omniscv.geometry import Pose
from omniscv.sources import Request, View
from omniscv.sources.unreal import open_connection
from omniscv.sources.unreal.objects import boxes, colors, paint

EDGE = 64


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(server, "EDGE_PX", EDGE)


@contextmanager
def visited(*before, change=None, scene="four-wall", **options):
    """A connection to a server, after some commands, and a raw camera there that drops no frames."""
    with mock_server.serve(scene, **{"size": (server.EDGE_PX,) * 2, "seed": 2, **options}) as running:
        relay = relayed(running, change or (lambda command, forward: forward(command)))
        with relay as uri, open_connection(uri, timeout_s=10) as connection:
            connection.texts(before)
            with RawCamera(connection) as camera:
                camera.lag = 0
                yield connection, camera


MOVING = {"scene": SCENE, "time_step_s": 0.02, "frames_per_s": 2000}
TICKS = MOVING | {"time_step_s": 0.0, "frames_per_s": 1.0}  # a request ends a frame, and nothing else does


def motion(**options):
    with visited(**MOVING | options) as (connection, camera):
        return {finding.name: finding for finding in MovingWorld(connection, camera).findings()}


def test_a_server_without_faults_is_ok():
    with mock_server.serve("four-wall") as running:
        findings = {each.name: each for each in doctor.examine_address(running.uri)}
    assert {finding.verdict for finding in findings.values()} == {"ok"}
    assert findings["dialect"].value.startswith("N3: plugin 1.1.0")
    assert findings["depth is"].value.startswith("planar")
    assert findings["depth unit"].value.startswith("cm")
    assert findings["depth steps"].value.startswith("float16")
    assert findings["mask colours"].value.endswith("0% black")
    assert findings.keys() >= {"exposure", "vignette", "same again", "depth, moved", "world moves"}


@pytest.mark.parametrize("quick", [True, False])
def test_plugin_0_3_10_is_measured_by_its_depth_and_its_lag(quick):
    """No finding warns of what needs nothing: recordings skip stale frames, and allow for fixed sizes."""
    with mock_server.serve("four-wall", dialect="0.3.10", size=(EDGE, EDGE), depth="float32") as running:
        findings = {each.name: each for each in doctor.examine_address(running.uri, quick=quick)}
        served = running.statistics.total("vget /camera/0/lit png")
    assert {each.verdict for each in findings.values()} == {"ok"}
    assert findings["depth is"].value.startswith("ray")
    assert findings["depth steps"].value.startswith("float32")
    assert findings["pose settles"].value.startswith("stale frames: 2")
    assert "not: points straight up" in findings["capabilities"].value
    assert "mask colours" in findings
    measured = {name in findings for name in ("depth unit", "exposure", "world moves")}
    assert measured == {not quick}
    assert quick == (served <= 15)
    assert quick or findings["depth unit"].value.startswith("m;")


def test_a_folder_of_captures_is_examined_as_its_recording(recorded, tmp_path, capsys):
    assert run(["recording", "export", str(recorded), str(tmp_path / "faces")]) == 0
    texts = []
    for path in (recorded, tmp_path / "faces"):
        capsys.readouterr()
        texts.append((run(["doctor", str(path), "--json"]), capsys.readouterr().out))
    assert texts[0] == texts[1]
    assert '"seams"' in texts[0][1]


@pytest.mark.parametrize("room", ["fence", "open"])
def test_thin_bars_and_an_even_ground_fit_many_fields_of_view(room):
    with mock_server.serve(room) as running:
        findings = doctor.examine_address(running.uri, quick=True)
    assert [each for each in findings if each.verdict == "bad"] == []


def turned(connection, camera):
    pairs = doctor.turned_pairs(camera)
    kind, meaning = doctor.depth_kind(pairs, camera)
    return [doctor.field_of_view("depth", pairs, camera, kind), meaning, doctor.half_floats(pairs, "cm")]


def masks(connection, camera):
    paint(connection, vertex_colors=False)
    return [doctor.masks(connection, camera, doctor.turned_pairs(camera))]


def agree(connection, camera):
    table = colors(connection)
    return agreement.findings(camera, table, boxes(connection, list(table)))


PARTS = {
    "settle": lambda connection, camera: [doctor.settle(camera)],
    "warm up": lambda connection, camera: [doctor.warm_up(camera)],
    "normals": lambda connection, camera: [doctor.normals(camera)],
    "turned": turned,
    "unit": lambda connection, camera: [doctor.depth_unit(camera)[1]],
    "masks": masks,
    "agree": agree,
    "agree six-wall": agree,
    "agree open": agree,
    "motion": lambda connection, camera: MovingWorld(connection, camera).findings(),
    "ticks": lambda connection, camera: MovingWorld(connection, camera).findings(),
}
SCENES = {"agree six-wall": "six-wall", "agree open": "open"}  # of the parts that are not in four-wall

NAMED = [
    ("stale=1000", "settle", "pose settles", "the camera does not turn"),
    ("ignore-pose", "settle", "pose settles", "the camera does not turn"),
    ("moving-world", "settle", "pose settles", "the world moves"),
    ("temporal", "warm up", "colours settle", "temporal effects"),
    ("lit-normals", "normals", "normals", "the lit image"),
    ("narrow-fov", "turned", "field of view, depth", "90.0 reported"),
    ("ray-depth", "turned", "depth is", "ray"),
    ("depth-scale=0.1", "unit", "depth unit", "neither cm nor m"),
    ("near-colors", "masks", "mask colours", "of no object"),
    ("mask-blur=2", "masks", "mask colours", "of no object"),
    ("jpeg", "masks", "mask colours", "of no object"),
    ("exposure-drift", "agree", "exposure", "between pictures"),
    ("exposure-drift=0.01", "agree", "same again", "colours"),
    ("vignette=0.3", "agree", "vignette", "corners 30"),
    ("vignette=0.3", "agree", "colours, turned", "disagree"),
    ("bloom=0.5", "agree", "colours, turned", "disagree"),
    ("jitter=0.5", "agree", "same again", "of depth"),
    ("moving-world=0.001", "agree", "same again", "of depth"),
    ("turned=1", "agree", "depth, turned", "disagrees"),
    ("radial-depth=0.1", "agree", "depth, turned", "disagrees"),
    ("far-plane=2", "agree", "depth, turned", "disagrees"),
    ("depth-bits=12", "agree", "depth, turned", "disagrees"),
    ("depth-mantissa", "agree", "depth, turned", "disagrees"),
    ("distortion=0.05", "agree", "depth, turned", "disagrees"),
    ("far-origin=1000", "agree", "depth, moved", "disagrees"),
    ("near-plane=100", "agree", "things that come and go", "looks through"),
    ("depth-scale=0.01", "agree six-wall", "depth scale", "+"),
    ("mask-noise=3", "agree", "same again", "of masks"),
    ("lit-offset=1", "agree six-wall", "colours over masks", "1 px right"),
    ("mask-offset=3", "agree", "colours over masks", "-3 px right"),
    ("color-cast=0.3", "agree", "colours that depend on the view", ""),
    ("roll=5", "agree six-wall", "depth, turned", ""),
    ("gloss=Layout_Floor", "agree", "colours that depend on the view", "Layout_Floor"),
    ("vanishing@0.3", "agree", "objects where they should be", "is not shown"),
    ("glass=Sofa", "agree", "objects where they should be", "Sofa is not shown"),
    ("sky-dome=100", "agree open", "domes", "SkyDome at 100 m"),
    ("late-objects=7", "ticks", "captures follow a move", "stale ticks: "),
    ("ignore-pause", "motion", "world pauses", "Ball still moving"),
]
REFUSED = [("refuse-mask", "Captured data is empty"), ("authentication", "Authentication required")]
CONNECTION = """delay drip missing wrong-id no-id clicked cut bad-magic zero-size huge reset no-greeting
    second-client"""  # requests are sent again
HARMLESS = {
    "put right before it is measured, by the colours that recordings set": "object-missing mask-gamma",
    "of the player's camera, which the doctor leaves alone": "falling",
    "of manual exposure, which is measured by itself": "dark-manual",
    "of brightness alone: as likely the artist's wish": "tone",
    "of captures in a world that moves, which is paused": "torn",
}
HARMLESS_NAMES = " ".join(HARMLESS.values()).split()


@contextmanager
def findings(part, *faults):
    scene = SCENES.get(part, "four-wall")
    options = {}
    if not part.startswith("agree"):
        options["depth"] = "float32"
    options |= {"motion": MOVING, "ticks": TICKS}.get(part, {})
    with visited(**{"scene": scene, "faults": faults, **options}) as (connection, camera):
        yield PARTS[part](connection, camera)


@pytest.mark.parametrize("part", ["agree six-wall", "agree open", "motion", "ticks"])
def test_without_a_fault_nothing_is_named(part):
    with findings(part) as results:
        found = {finding.name: finding for finding in results}
    texts = {(name, text) for _, where, name, text in NAMED if where == part}
    assert texts or part.startswith("agree")
    assert all(found[name].verdict == "ok" or text not in found[name].value for name, text in texts)
    if part.startswith("agree"):
        assert {finding.verdict for finding in found.values()} == {"ok"}


def by_finding():
    """All rows, of which the suite runs the first that is named so."""
    known = set()
    for row in NAMED:
        marks = [pytest.mark.soak] if row[1:] in known else []
        known.add(row[1:])
        yield pytest.param(*row, marks=marks)


@pytest.mark.parametrize(("fault", "part", "name", "text"), [*by_finding()])
def test_a_fault_is_named(fault, part, name, text, monkeypatch):
    if "gloss" not in fault:  # which is too little of a smaller picture
        monkeypatch.setattr(server, "EDGE_PX", 48)
    with findings(part, fault) as results:
        finding = next(each for each in results if each.name == name)
    assert text in finding.value
    assert finding.verdict == ("warning" if fault == "near-plane=100" else "bad")


@pytest.mark.parametrize(("fault", "text"), REFUSED)
def test_a_server_that_refuses_is_not_measured(fault, text):
    refused = pytest.raises(ServerRefusedError, match=text)
    with mock_server.serve("four-wall", size=(EDGE, EDGE), faults=[fault]) as running, refused:
        doctor.examine_address(running.uri, quick=True)


def test_what_spoils_no_capture_is_not_named():
    with mock_server.serve("four-wall", size=(EDGE, EDGE), faults=HARMLESS_NAMES) as running:
        found = doctor.examine_address(running.uri, quick=True)
    assert {finding.verdict for finding in found} == {"ok"}


def test_every_fault_of_the_mock_has_its_place():
    named = {re.split("[=@]", row[0])[0] for row in (*NAMED, *REFUSED)}
    assert sorted([*named, *CONNECTION.split(), *HARMLESS_NAMES]) == sorted(KINDS)


def test_things_thinner_than_a_pixel_come_and_go():
    with visited(scene="fence") as (connection, camera):
        found = {each.name for each in agree(connection, camera) if each.verdict != "ok"}
    assert found == {"things that come and go"}


def test_the_window_of_plugin_0_3_10_may_differ_from_the_camera():
    for window, fov_deg, actor, says, verdict in (
        ((88, 64), 90, False, "up and down", "bad"),
        ((64, 64), 70, False, "70", "bad"),
        ((64, 64), 70, True, "90.0 reported, by a CameraActor", "ok"),
    ):
        options = {"window": window, "fov_deg": fov_deg, "camera_actor": actor, "right_eye": actor}
        with visited(dialect="0.3.10", **options) as (connection, camera):
            eyes = [finding.value for finding in doctor.right_eye(connection, camera)]
            assert eyes == ["two: captures use camera 0, the left eye"] * actor
            camera.lag = 3
            pairs = doctor.turned_pairs(camera)
            assert doctor.sizes(pairs, camera).verdict == ("ok" if window == (64, 64) else "warning")
            assert doctor.field_of_view("lit", pairs, camera, "ray").verdict == "ok"
            mask = doctor.field_of_view("object_mask", pairs, camera, "ray")
            assert mask.verdict == verdict
            assert says in mask.value


def test_the_windows_view_mode_gets_into_captures_and_stale_frames_are_counted():
    with visited("vset /viewmode normal", faults=["stale=3"]) as (connection, camera):
        assert doctor.view_mode(connection).verdict == "bad"
        connection.texts([doctor.view_mode(connection).remedy])
        assert doctor.view_mode(connection).verdict == "ok"
        assert doctor.settle(camera).verdict == "ok"
        assert camera.lag == 3


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


def test_frames_that_blend_are_counted_and_dropped():
    """Half of the last image stays in each: the differences halve from frame to frame."""
    with mock_server.serve("four-wall", size=(48, 48), faults=["temporal=0.5"]) as running:
        with open_connection(running.uri) as connection, RawCamera(connection) as camera:
            camera.lag = 0
            finding = doctor.warm_up(camera)
        count = int(re.search(r"\d+", finding.value)[0])
        assert 4 <= count <= 8  # 8 bits
        assert finding.remedy == f"--set source_options.warmup={count}"
        errors = []
        for warmup in (0, count):
            with omniscv.open_source(running.uri, warmup=warmup) as source:
                views = [View(Pose.from_angles((0, 0, 1.5), yaw), 90.0, 48, 48) for yaw in (0, 90, 200)]
                captures = list(source.capture(Request(view, "lit") for view in views))
            with omniscv.open_source("mock://four-wall") as still:
                truth = list(still.capture(capture.request for capture in captures))
            off = [np.abs(a.pixels.astype(int) - b.pixels) for a, b in zip(captures, truth, strict=True)]
            errors.append(max(float(np.quantile(each, 0.99)) for each in off[1:]))
    assert errors[0] > 20
    assert errors[1] <= 2  # what remains of changes below a level, and rounding


@pytest.mark.parametrize("dialect", ["0.3.10", "N1"])
def test_a_world_that_moves_is_paused_and_left_as_it_was(dialect):
    with serve(dialect, time_step_s=0.02) as running:
        with open_connection(running.uri) as connection, RawCamera(connection) as camera:
            camera.lag = 0
            found = {each.name: each for each in MovingWorld(connection, camera).findings()}
        world = running.world
    assert found["world moves"].value == "yes: Ball"
    assert found["world moves"].verdict == "warning"
    assert found["world pauses"].verdict == "ok"
    late = {"at once", "stale ticks: 1"} if dialect == "0.3.10" else {"at once"}
    assert found["captures follow a move"].value in late
    assert not world.paused
    assert {name: each.location for name, each in world.objects.items() if name != "Ball"} == {
        "Box": (200.0, -50.0, 140.0),
        "Pole": (150.0, 160.0, 150.0),
    }


@pytest.mark.parametrize(("late", "verdict"), [(2, "ok"), (5, "bad")])
def test_ticks_are_counted_until_a_capture_shows_a_move(late, verdict):
    finding = motion(**TICKS, faults=[f"late-objects={late}"])["captures follow a move"]
    assert (finding.value, finding.verdict) == (f"stale ticks: {late}", verdict)


def test_the_manual_exposure_of_recordings_is_named():
    for faults, found in (
        ([], ("ok", "as bright as the game's own with a bias of 0")),
        (["dark-manual=2"], ("ok", "as bright as the game's own with a bias of 2")),
        (["dark-manual=20"], ("warning", "no bias matches the game's own")),
    ):
        with visited(scene="four-wall", faults=faults) as (connection, camera):
            (finding,) = doctor.manual_exposure(connection, camera)
        assert (finding.verdict, finding.value) == found


def test_a_server_that_refuses_to_pause_is_a_warning():
    pauses = motion(change=answering("error Argument Invalid", "/action/game"))["world pauses"]
    assert pauses.verdict == "warning"
    assert "Argument Invalid" in pauses.value


def test_remedies_are_options_of_the_commands_that_capture(tmp_path):
    with findings("agree", "vignette", "exposure-drift") as spoiled:
        remedies = " ".join(each.remedy for each in (*spoiled, *motion(dialect="N2").values()))
    remedies = remedies.replace("--overscan 512", "--overscan 8")
    named = set(re.findall(r"(record )?(--\S+) ([\w.=]+)", remedies))
    assert {option for _, option, _ in named} == {"--set", "--overscan"}
    source = ["--source", "mock://four-wall", "--modes", "lit", "--set", "face_size=16"]
    for number, (only, option, value) in enumerate(named):
        assert run(["record", *source, option, value, "--out", str(tmp_path / f"room-{number}.sqlite")]) == 0
        if not only:
            assert run(["render", *source, option, value, "--size", "32x16", "--out", str(tmp_path)]) == 0
