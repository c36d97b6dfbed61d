"""The live source with every dialect: captures agree with tracing of the view that they carry."""

import time

import numpy as np
import pytest
from faces import CENTER, face_requests

import mock_server
import omniscv
from omniscv.captures.source import Capabilities
from omniscv.captures.unreal.session import Session
from omniscv.captures.view import MODES, Request, View
from omniscv.chart.truth import traced
from omniscv.compose.labels import labels_of
from omniscv.errors import BadReply, MissingCapture, ServerRefused
from omniscv.geometry import Pose

DIALECTS = ["0.3.10", "M", "N1", "N2"]
SIZE = 48
ROOM = mock_server.load_scene("four-wall")
FACES = face_requests(SIZE, MODES)

SPAWNED = {"can_spawn": True, "pipelines": True}
CAPABILITIES = {
    "0.3.10": Capabilities(
        can_set_size=False,
        can_look_vertical=False,
        image_size=(SIZE, SIZE),
        mask_through_viewport=True,
        depth_kind="ray",
        depth_unit="m",
        dialect="0.3.10",
    ),
    "M": Capabilities(**SPAWNED, dialect="M"),
    "N1": Capabilities(**SPAWNED, dialect="N1"),
    "N2": Capabilities(**SPAWNED, dialect="N2"),
}


def serve(dialect="0.3.10", scene=ROOM, size=(SIZE, SIZE), **options):
    return mock_server.serve(scene, dialect=dialect, size=size, **options)


@pytest.fixture(scope="module", params=DIALECTS)
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


def hits_of(view, scene=ROOM):
    """What a view's rays meet, and their lengths at planar depth 1."""
    f = view.width / 2 / np.tan(np.radians(view.fov_deg) / 2)
    u, v = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    rays_c = np.stack([(u - view.width / 2) / f, (v - view.height / 2) / f, np.ones_like(u)], axis=-1)
    hits = scene.trace(view.pose.t_w_c, rays_c @ view.pose.R_w_c.T)
    return hits, np.linalg.norm(rays_c, axis=-1)


def agrees(capture, source, scene=ROOM):
    """Whether all pixels but those on an edge, where a last digit decides, are what was traced."""
    hits, length = hits_of(capture.view, scene)
    if capture.mode == "lit":  # colours are rounded to 8 bits
        wrong = (np.abs(capture.pixels - 255 * hits.color) > 0.5 + 1e-4).any(axis=-1)
    elif capture.mode == "object_mask":
        labels, unknown = labels_of(capture.pixels, source.objects())
        wrong = (labels != hits.label) | bool(unknown)
    elif capture.mode == "normal":  # 8 bits for -1 to 1, then made a unit vector again
        wrong = (np.abs(capture.pixels - hits.normal) > 2 / 255).any(axis=-1)
    else:  # half floats, of what the dialect sends
        capabilities = source.capabilities
        to_wire = (length if capabilities.depth_kind == "ray" else 1) * (
            100 if capabilities.depth_unit == "cm" else 1
        )
        sent = np.where(np.isfinite(hits.distance), hits.distance / length * to_wire, 1.0)
        step = np.spacing(sent.astype(np.float16)).astype(float) / to_wire
        off = np.abs(np.where(np.isinf(capture.pixels), 0, capture.pixels) - sent / to_wire)
        both_sky = np.isinf(capture.pixels) & np.isinf(hits.distance)
        wrong = ~both_sky & ~((off <= step / 2 + 1e-6) & np.isfinite(capture.pixels))
    return wrong.mean() < 0.005


def rotation_between(a, b):
    """Degrees."""
    cosine = (np.trace(a.pose.R_w_c.T @ b.pose.R_w_c) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_what_a_server_can_do_is_found_out_whatever_it_calls_itself(server, source):
    assert source.capabilities == CAPABILITIES[server.dialect]


def test_captures_are_what_the_view_they_carry_sees(source, captures):
    assert [capture.request for capture in captures] == FACES
    wrong = [(c.mode, c.view.pose.angles()) for c in captures if not agrees(c, source)]
    assert not wrong


def test_views_are_the_ones_asked_for_as_far_as_the_dialect_goes(server, captures):
    for capture in captures:
        asked, came = capture.request.view, capture.view
        vertical = abs(asked.pose.angles()[1]) > 89
        if server.dialect == "0.3.10" and vertical:
            assert rotation_between(asked, came) == pytest.approx(0.1, abs=1e-6)
            assert (came.fov_deg, came.width, came.height) == (asked.fov_deg, SIZE, SIZE)
        else:
            assert came == asked


def test_any_pose_comes_out_right(source):
    rng = np.random.default_rng(3)
    angles = rng.uniform((-180, -95, -80), (180, 95, 80), (6, 3))
    places = rng.uniform((-1, -1, 0.5), (1, 1, 2.0), (6, 3))
    views = [View(Pose.from_angles(p, *a), 75.0, SIZE, SIZE) for p, a in zip(places, angles, strict=True)]
    for capture in source.capture(Request(view, mode) for view in views for mode in MODES):
        assert agrees(capture, source), (capture.mode, capture.view)
        np.testing.assert_allclose(capture.view.pose.t_w_c, capture.request.view.pose.t_w_c, atol=1e-8)


@pytest.mark.parametrize("strategy", ["auto", "cube"])
def test_a_panorama_is_the_traced_one(source, strategy):
    camera = omniscv.cameras.create("equirectangular", width=128, height=64)
    pose = Pose.from_angles(CENTER, yaw_deg=25, pitch_deg=10, roll_deg=-5)
    image = omniscv.render(camera, pose, source, MODES, strategy=strategy, face_size=SIZE)
    truth = traced(ROOM, camera, pose)
    assert image.valid.all()
    # Pixels on edges of objects: 2 % of them at this size.
    assert (image.labels == truth.label).mean() > 0.97
    error = np.abs(image.depth - truth.distance) / truth.distance
    assert np.median(error) < 2.0**-11  # half floats
    assert not image.layers.unknown_colors


# What only plugin 0.3.10 does.


def test_one_round_of_captures_disturbs_neither_the_stream_nor_the_window():
    """Out of step, or after a fault, the source would connect, and ask for the version, again."""
    with serve() as server:
        with omniscv.open_source(server.uri) as source:
            list(source.capture(FACES))
        session = Session((server.host, server.port))
        assert list(session.stream(["vget /viewmode"])) == ["lit"]
        session.close()
        assert server.statistics.counts["vset /action/input/disable"] == 1
        assert server.statistics.counts["vget /unrealcv/version"] == 1


def test_masks_have_the_windows_size_and_field_of_view():
    with (
        serve(size=(64, 48), window=(80, 60)) as server,
        omniscv.open_source(server.uri) as source,
    ):
        view = View(Pose.from_angles(CENTER, 30.0), 70.0, 200, 100)
        found = {c.mode: c for c in source.capture(Request(view, mode) for mode in MODES)}
        for mode, capture in found.items():
            expected = (90.0, 80, 60) if mode == "object_mask" else (70.0, 64, 48)
            assert (capture.view.fov_deg, capture.view.width, capture.view.height) == expected
            assert capture.pixels.shape[:2] == (expected[2], expected[1])
            assert agrees(capture, source), mode


def test_without_masks_the_rest_is_captured(monkeypatch):
    """Engines after 4.16 broke them."""
    monkeypatch.setattr(mock_server.dialects.l.L, "_window_mask", lambda *_: "error Fail to capture screen")
    with serve() as server, omniscv.open_source(server.uri) as source:
        assert source.capabilities.modes == {"lit", "depth", "normal"}
        assert agrees(*source.capture([Request(FACES[0].view, "depth")]), source)
        with pytest.raises(ServerRefused, match="for depth, lit or normal, got object_mask"):
            list(source.capture([Request(FACES[0].view, "object_mask")]))


def test_a_window_that_shows_too_little_is_told():
    """As it opens, 640 x 480: colour and depth can be widened until 90 degrees are seen up and down too."""
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    pose = Pose.from_angles(CENTER)
    with omniscv.open_source("mock://four-wall?dialect=0.3.10&size=64x48") as source:
        assert omniscv.render(camera, pose, source, ("lit", "depth")).valid.all()
        with pytest.raises(MissingCapture, match=r"they came as 64 x 48 of 90 degrees.*a square one"):
            omniscv.render(camera, pose, source, ("object_mask",))


def test_a_window_that_is_higher_than_wide_is_refused():
    expected = "expected pictures at least as wide as high, got 20 x 40"
    with serve(window=(20, 40)) as server, pytest.raises(ServerRefused, match=expected):
        omniscv.open_source(server.uri)


def test_mask_colours_are_ones_that_vertex_colours_show():
    """With more objects than the 26 first colours, whose channels are 0, 127 and 255, some would bend."""
    solids = {
        f"Ball_{i:02}": {"solids": [{"sphere": 0.2, "at": [2, 0.4 * (i % 8) - 1.4, 0.4 * (i // 8) + 0.4]}]}
        for i in range(48)
    }
    scene = mock_server.Scene("balls", {"objects": solids})
    view = View(Pose.from_angles((-1.5, 0, 1.4)), 90.0, SIZE, SIZE)
    with serve(scene=scene, window=(256, 256)) as server, omniscv.open_source(server.uri) as source:
        (capture,) = source.capture([Request(view, "object_mask")])
        shown = {tuple(color) for color in capture.pixels.reshape(-1, 3).tolist()}
        assert shown == {(0, 0, 0), *source.objects().colors.values()}
        assert len(shown) == 49
        assert agrees(capture, source, scene)


def test_a_record_replays_the_views_that_came(tmp_path):
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    pose = Pose.from_angles(CENTER)
    with (
        serve() as server,
        omniscv.open_source(server.uri) as live,
        omniscv.record(live, tmp_path / "room.sqlite") as source,
    ):
        image = omniscv.render(camera, pose, source, MODES)
    with omniscv.open_source(tmp_path / "room.sqlite") as replay:
        again = omniscv.render(camera, pose, replay, MODES)
    for layer in ("lit", "object_mask", "labels", "depth", "normals"):
        np.testing.assert_array_equal(getattr(again, layer), getattr(image, layer), err_msg=layer)


@pytest.mark.parametrize(
    "fault", ["clicked@0.3", "reset@0.02", "cut=0.5@0.02", "missing@0.01", "stale=1", "stale=2"]
)
def test_faults_lose_and_spoil_nothing(fault):
    with serve(seed=5) as server:
        with omniscv.open_source(server.uri) as source:
            truth = [capture.payload for capture in source.capture(FACES[:12])]
        server.faults.start(fault)
        with omniscv.open_source(server.uri, timeout_s=0.5, retries=8) as source:
            captures = list(source.capture(FACES[:12]))
        assert [capture.payload for capture in captures] == truth
        assert server.faults.struck[fault.partition("=")[0].partition("@")[0]]


def test_a_pawn_that_falls_is_refused(monkeypatch):
    def fall(self):
        x, y, z = self.location
        self.location = (x, y, z - 1.0)
        tick(self)

    tick = mock_server.player.Player.tick
    monkeypatch.setattr(mock_server.player.Player, "tick", fall)
    expected = "expected a camera that comes to rest, but it moves on"
    with (
        serve() as server,
        omniscv.open_source(server.uri, retries=0) as source,
        pytest.raises(BadReply, match=expected),
    ):
        list(source.capture(FACES[:1]))


def test_a_camera_that_stays_elsewhere_is_refused(monkeypatch):
    """As where the level has a CineCameraActor, whose pose is told instead of the pawn's."""
    monkeypatch.setattr(mock_server.dialects.l.L, "_pose", lambda *_: "ok")
    expected = r"expected a camera at \(100.0, .*CineCameraActor"
    with (
        serve() as server,
        omniscv.open_source(server.uri, retries=0) as source,
        pytest.raises(ServerRefused, match=expected),
    ):
        list(source.capture(face_requests(SIZE, ["lit"], center=(1.0, 0.0, 1.5))[:1]))


@pytest.mark.parametrize("dialect", ["M", "N1", "N2"])
def test_the_spawned_camera_leaves_with_the_source(dialect):
    """A game that is recorded again and again does not fill with cameras."""
    with mock_server.serve("four-wall", dialect=dialect) as server:
        for _ in range(3):
            with omniscv.open_source(server.uri) as source:
                list(source.capture(face_requests(modes=("lit",))[:1]))
                assert len(server._world.cameras) == 2
            deadline = time.monotonic() + 5
            while len(server._world.cameras) > 1 and time.monotonic() < deadline:
                time.sleep(0.01)
            assert len(server._world.cameras) == 1
