"""The live source with every dialect: captures agree with tracing of the view that they carry."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from support.faces import CENTER, face_requests
from support.unreal import MODES, agrees, answering, many_balls, relayed

import mock_server
import omniscv
from omniscv.errors import ArgumentError, BadReplyError, MissingCaptureError, ServerRefusedError, SourceError
from omniscv.geometry import Pose
from omniscv.sources import Capabilities, Lens, Request, View
from omniscv.sources.unreal import open_connection
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.protocol import DIALECTS

SIZE = 48
ROOM = mock_server.load_scene("four-wall")
FACES = face_requests(SIZE, MODES)


def capabilities(dialect):
    modern = {"modes": frozenset(MODES), "can_set_tall": False, "dialect": dialect}
    modern["varies"] = frozenset({"objects", "commands"})
    modern["can_set_exposure"] = dialect in ("N2", "N3")
    legacy = {"can_set_size": False, "image_size": (SIZE, SIZE)} if dialect == "0.3.10" else {}
    return Capabilities(**modern, **legacy)


def serve(dialect="0.3.10", scene=ROOM, size=(SIZE, SIZE), **options):
    return mock_server.serve(scene, dialect=dialect, size=size, **options)


@pytest.fixture(scope="module", params=[*DIALECTS])
def server(request):
    with serve(request.param) as running:
        running.dialect = request.param
        yield running


@pytest.fixture(scope="module")
def source(server):
    with omniscv.open_source(server.uri) as opened:
        yield opened


@pytest.fixture(scope="module")
def captures(source):
    return list(source.capture(FACES))


def rotation_between(a, b):
    cosine = (np.trace(a.pose.R_w_c.T @ b.pose.R_w_c) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_capabilities_are_probed_whatever_version_is_reported(server, source):
    assert source.capabilities == capabilities(server.dialect)


def test_captures_are_what_the_view_they_carry_sees_which_is_the_one_requested_if_possible(
    server, source, captures
):
    assert [capture.request for capture in captures] == FACES
    for capture in captures:
        requested = capture.request.view
        came = capture.view
        assert agrees(capture, source, ROOM), (capture.mode, came.pose.angles())
        if server.dialect == "0.3.10" and abs(requested.pose.angles()[1]) > 89:
            assert rotation_between(requested, came) == pytest.approx(0.1, abs=1e-6)
            assert (came.fov_deg, came.width, came.height) == (requested.fov_deg, SIZE, SIZE)
        else:
            assert came == requested


def test_any_pose_comes_out_right(source):
    rng = np.random.default_rng(3)
    angles = rng.uniform((-180, -95, -80), (180, 95, 80), (4, 3))
    places = rng.uniform((-1, -1, 0.5), (1, 1, 2.0), (4, 3))
    views = [View(Pose.from_angles(p, *a), 75.0, SIZE, SIZE) for p, a in zip(places, angles, strict=True)]
    for capture in source.capture(Request(view, mode) for view in views for mode in MODES):
        assert agrees(capture, source, ROOM), (capture.mode, capture.view)
        np.testing.assert_allclose(capture.view.pose.t_w_c, capture.request.view.pose.t_w_c, atol=1e-8)


def test_one_round_of_captures_disturbs_neither_the_stream_nor_the_window_nor_the_player():
    """Out of step, or after a fault, the source would connect, and request the version, again.

    Pictures come behind three round trips after a move, and before another: fewer may show the pose before,
    and each more costs a tick (protocol reference, section 7.2).
    """
    with serve() as server:
        with open_connection(server.uri) as connection:
            connection.text("vset /camera/0/pose 10 20 130 5 40 0")
        with omniscv.open_source(server.uri) as source:
            before = server.statistics.counts.copy()
            list(source.capture(FACES))
            sent = server.statistics.counts - before
        moves = sum(count for text, count in sent.items() if text.startswith("vset /camera/0/pose"))
        assert moves == len(FACES)  # they go mode by mode
        assert sent["vget /camera/0/pose"] == (3 + 1) * moves
        with open_connection(server.uri) as connection:
            assert connection.text("vget /viewmode") == "lit"
            *_, pose = connection.texts(["vget /camera/0/pose"] * 4)
        assert [float(number) for number in pose.split()] == [10, 20, 130, 5, 40, 0]
        assert server.statistics.counts["vset /action/input/disable"] == 1
        assert server.statistics.counts["vget /unrealcv/version"] == 1


@pytest.mark.parametrize("actor", [False, True])
def test_masks_have_the_windows_size_and_its_field_of_view_or_that_of_a_camera_actor(actor):
    with (
        serve(size=(64, 48), window=(80, 60), camera_actor=actor, right_eye=True) as server,
        omniscv.open_source(server.uri) as source,
    ):
        view = View(Pose.from_angles(CENTER, 30.0), 70.0, 200, 100)
        found = {c.mode: c for c in source.capture(Request(view, mode) for mode in MODES)}
        for mode, capture in found.items():
            expected = (70.0 if actor else 90.0, 80, 60) if mode == "object_mask" else (70.0, 64, 48)
            assert (capture.view.fov_deg, capture.view.width, capture.view.height) == expected
            assert capture.pixels.shape[:2] == (expected[2], expected[1])
            assert agrees(capture, source, ROOM), mode


def test_without_masks_the_rest_is_captured():
    with serve(faults=["refuse-mask"]) as server, omniscv.open_source(server.uri) as source:
        assert source.capabilities.modes == {"lit", "depth", "normals"}
        assert agrees(*source.capture([Request(FACES[0].view, "depth")]), source, ROOM)
        with pytest.raises(ServerRefusedError, match="for depth, lit or normals, got object_mask"):
            list(source.capture([Request(FACES[0].view, "object_mask")]))


def test_a_window_that_is_higher_than_wide_and_a_camera_of_the_level_are_refused():
    expected = "expected pictures at least as wide as high, got 20 x 40"
    with serve(window=(20, 40)) as server, pytest.raises(ServerRefusedError, match=expected):
        omniscv.open_source(server.uri)
    refused = pytest.raises(ArgumentError, match=r"expected no .camera, .*; give --position")
    with serve("N3") as server, refused:
        omniscv.open_source(f"{server.uri}?camera=1")


def test_a_window_that_shows_too_little_is_reported():
    """As it opens, 640 x 480: colour and depth can be widened until they show 90 degrees up and down too."""
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    pose = omniscv.Pose.from_angles(CENTER)
    with omniscv.open_source("mock://four-wall?dialect=0.3.10&size=64x48") as source:
        assert omniscv.render(camera, pose, source, ("lit", "depth")).valid.all()
        with pytest.raises(MissingCaptureError, match=r"they came as 64 x 48 of 90 degrees.*square pictures"):
            omniscv.render(camera, pose, source, ("object_mask",))


def test_mask_colours_are_ones_that_vertex_colours_show():
    """With more objects than the 26 first colours, whose channels are 0, 127 and 255, some would change."""
    scene = mock_server.Scene("balls", {"objects": many_balls()})
    view = View(Pose.from_angles((-1.5, 0, 1.4)), 90.0, SIZE, SIZE)
    with serve(scene=scene, window=(256, 256)) as server, omniscv.open_source(server.uri) as source:
        (capture,) = source.capture([Request(view, "object_mask")])
        shown = {tuple(color) for color in capture.pixels.reshape(-1, 3).tolist()}
        assert shown == {(0, 0, 0), *source.objects().colors.values()}
        assert len(shown) == 49
        assert agrees(capture, source, scene)


@pytest.mark.parametrize("fault", ["reset@0.02", "stale=2"])
def test_faults_lose_and_spoil_nothing(fault):
    with serve(seed=5) as server:
        with omniscv.open_source(server.uri) as source:
            truth = [capture.payload for capture in source.capture(FACES[:12])]
        server.faults.start(fault)
        with omniscv.open_source(server.uri, timeout_s=0.5, retries=8) as source:
            captures = list(source.capture(FACES[:12]))
        assert [capture.payload for capture in captures] == truth
        assert server.faults.struck[fault.partition("=")[0].partition("@")[0]]


def test_a_pawn_that_falls_or_stays_elsewhere_is_refused():
    for fault, error, says in (
        ("falling=2", BadReplyError, "expected a camera that comes to rest, but it still moves"),
        ("ignore-pose", ServerRefusedError, r"expected a camera at \(100.0, .*CineCameraActor"),
    ):
        with serve() as server, omniscv.open_source(server.uri, retries=0) as source:
            server.faults.start(fault)
            with pytest.raises(error, match=says):
                list(source.capture(face_requests(SIZE, ["lit"], center=(1.0, 0.0, 1.5))[:1]))


def test_vertical_views_are_covered_by_two():
    """Pitch is limited to 89.9 degrees: the second view is tilted to the other side."""
    with serve() as server, omniscv.open_source(server.uri) as source:
        for request in FACES[:6]:
            vertical = abs(request.view.pose.angles()[1]) > 89
            views = source.cover(request.view)
            assert views[0] == request.view
            assert len(views) == 1 + vertical
            if vertical:
                first, second = (c.view.pose.R_w_c for c in source.capture(Request(v, "lit") for v in views))
                middle = first[:, 2] + second[:, 2]
                middle /= np.linalg.norm(middle)
                np.testing.assert_allclose(middle, request.view.pose.R_w_c[:, 2], atol=1e-6)


@pytest.mark.parametrize("dialect", ["M", "N3"])
def test_the_spawned_camera_leaves_with_the_source(dialect):
    with serve(dialect) as server:
        for _ in range(3):
            with omniscv.open_source(server.uri) as source:
                list(source.capture(FACES[:1]))
            with open_connection(server.uri) as connection:
                assert connection.text("vget /cameras").split() == ["PawnSensor"]
        assert server.statistics.total("vset /cameras/spawn") == 3


@pytest.mark.parametrize("dialect", ["0.3.10", "N2"])
def test_a_source_that_is_closed_among_captures_stays_closed(dialect):
    with serve(dialect) as server:
        with omniscv.open_source(server.uri) as source:
            captures = source.capture(FACES * 2)  # more than one batch
            next(captures)
        with pytest.raises(SourceError, match="expected an open source, got"):
            list(captures)
        assert server.statistics.total("vget /unrealcv/version") <= 4


def test_views_that_engines_cannot_show_are_refused():
    for view, says in (
        ((90.0, 20, 30), "expected a view at least as wide as high, got 20 x 30"),
        ((179.5, 8, 8), "expected 1 to 179 degrees, which engines do not clamp"),
        ((90.0, 8, 8, Lens(0.75, -0.06, 0.1)), "lens: expected none of a game's camera, got Lens"),
    ):
        with omniscv.open_source("mock://four-wall") as source, pytest.raises(ArgumentError, match=says):
            list(source.capture([Request(View(Pose.from_angles(CENTER), *view), "depth")]))


def test_a_setting_that_is_not_kept_is_refused():
    for what, stays, says in (
        ("fov", "90.000000", r"a field of view, degrees, of 100.0, .* got '90.000000'"),
        ("size", "640 480", r"a size, px, of 64 48, which was set, got '640 480'"),
    ):
        change = answering(stays, f"vget /camera/1/{what}")
        refused = pytest.raises(ServerRefusedError, match=says)
        with mock_server.serve("four-wall") as server, relayed(server, change) as uri, refused:
            omniscv.open_source(uri)


def test_lit_images_in_place_of_normals_are_refused():
    with omniscv.open_source("mock://four-wall?fault=lit-normals") as source:
        view = View(Pose.from_angles(CENTER), 90.0, SIZE, SIZE)
        with pytest.raises(ServerRefusedError, match="expected pictures of normals, got the lit image"):
            list(source.capture([Request(view, "normals")]))


LEVEL = "vget /level/name"
BOUNDS = "vget /object/[str]/bounds"
METHOD = "vset /camera/[uint]/exposure_method [str]"
CINE = "vget /camera/[uint]/cine/enabled"
HAVE = {
    "0.3.10": set(), "M": {LEVEL, BOUNDS}, "N1": {BOUNDS, LEVEL}, "N2": {BOUNDS, LEVEL, METHOD},
    "N3": {BOUNDS, LEVEL, METHOD, CINE},
}  # fmt: skip


def plugin_of(uri):
    host, _, port = uri.removeprefix("unreal://").partition(":")
    with closing(Connection((host, int(port)))) as connection:
        return connection.plugin


def supported(plugin):
    return {template for template in (LEVEL, BOUNDS, METHOD, CINE) if template in plugin.templates}


@pytest.mark.parametrize("dialect", HAVE)
def test_commands_are_known_from_the_list_or_the_help_and_without_both_by_the_dialect(dialect):
    no_texts = answering("error no", "/commands", "/help")
    with serve(dialect) as server:
        plugin = plugin_of(server.uri)
        assert (plugin.dialect, supported(plugin)) == (dialect, HAVE[dialect])
        assert DIALECTS[dialect].batches == (dialect in ("N2", "N3"))
        with relayed(server, no_texts) as uri:
            without = plugin_of(uri)
    # Without its list N3 answers as N2 does, and the commands of cine cameras are not known.
    assert without.dialect == ("N2" if dialect == "N3" else dialect)
    assert supported(without) == HAVE[dialect] - {CINE}


def test_the_dev_build_is_taken_for_n3_and_a_list_that_does_not_hold_itself_is_not_believed():
    def dev(command, forward):
        reply = forward(command)
        return reply.replace(b"[uint]", b"[camera_id]") if command.endswith("/commands") else reply

    with serve("N3") as server, relayed(server, dev) as uri:
        plugin = plugin_of(uri)
    assert plugin.dialect == "N3"
    assert CINE in plugin.templates
    short = answering("vget /camera/[uint]/cine/enabled", "/commands")
    with serve("N1") as server, relayed(server, short) as uri:
        plugin = plugin_of(uri)
    assert (plugin.dialect, supported(plugin)) == ("N1", HAVE["N1"])


def test_the_documents_have_the_table():
    text = Path(__file__).parents[3].joinpath("docs", "engines.md").read_text()
    for name, dialect in DIALECTS.items():
        assert f"| {name} | {dialect.plugin} | {dialect.engine} |" in text
