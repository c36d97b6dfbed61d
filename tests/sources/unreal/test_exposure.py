"""The exposure of a spawned camera: the one that matches the game's, and captures at others."""

import logging

import numpy as np
import pytest
from support.unreal import answering, relayed

import mock_server
import omniscv
from omniscv.cli import run
from omniscv.errors import ArgumentError, ServerRefusedError
from omniscv.sources import Request, View
from omniscv.sources.base import SourceView
from omniscv.sources.registry import open_sources
from omniscv.sources.world import exposure_from_text, exposure_to_text

VIEWS = [View(omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=yaw), 90, 16, 16) for yaw in (0, 90)]


def requests(*stops):
    return [Request(view, mode, stops=at) for view in VIEWS for mode, at in stops]


@pytest.fixture
def server():
    with mock_server.serve("four-wall", dialect="N2") as server:
        yield server


def test_exposure_is_set_where_colours_need_another_one(server):
    with omniscv.open_source(server.uri, exposure="game") as source:
        list(source.capture(requests(("lit", None), ("depth", None))))
        assert not server.statistics.total("vset /camera/1/exposure")
        made = requests(("lit", -2), ("depth", None), ("lit", 2))
        assert [capture.request for capture in source.capture(made)] == made
        bias = "vset /camera/1/exposure_bias"
        assert [server.statistics.total(f"{bias} {stops}") > 0 for stops in (-2, 2, 0)] == [True, True, False]
        list(source.capture(requests(("lit", None))))
        assert server.statistics.total(f"{bias} 0") == 1


def test_exposures_are_captures_of_their_own(server, tmp_path):
    made = requests(("lit", -2), ("depth", None), ("lit", 0.5))
    path = tmp_path / "room.sqlite"
    with omniscv.open_source(server.uri) as live, omniscv.record(live, path) as source:
        payloads = [capture.payload for capture in source.capture(made)]
    again = tmp_path / "again.sqlite"
    assert run(["recording", "export", str(path), str(tmp_path / "folder")]) == 0
    assert run(["recording", "import", str(tmp_path / "folder"), str(again)]) == 0
    for each in (path, again):
        with omniscv.open_source(each) as source:
            replayed = list(source.capture(made))
            assert [capture.payload for capture in replayed] == payloads
            assert [capture.request for capture in replayed] == made


@pytest.mark.parametrize(("mode", "stops"), [("depth", 1), ("lit", 21), ("lit", float("nan"))])
def test_stops_are_of_colours_and_bounded(mode, stops):
    with pytest.raises(ArgumentError, match="stops: expected none, or -20 to 20 of lit"):
        Request(VIEWS[0], mode, stops=stops)


def colors(source, count=1, yaw_deg=0):
    poses = [omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=yaw) for yaw in (yaw_deg + 90, yaw_deg)]
    views = [View(pose, 90, 16, 16) for pose in poses]
    captures = list(source.capture([Request(view, "lit") for _ in range(count) for view in views]))
    return captures[1::2]


def exposure_of(capture):
    return capture.provenance.get("exposure")


@pytest.mark.parametrize("dialect", ["N2", "N3"])
def test_a_game_without_faults_shows_the_same_with_manual_exposure(dialect):
    with mock_server.serve("four-wall", dialect=dialect) as server:
        with omniscv.open_source(server.uri, exposure="game") as source:
            (before,) = colors(source)
        pictures = server.statistics.total("vget /camera/1/lit")
        with omniscv.open_source(server.uri) as source:
            list(source.capture([Request(VIEWS[0], "depth")]))
            assert not server.statistics.total("vset /camera/1/exposure")
            assert server.statistics.total("vget /camera/1/lit") == pictures
            (capture,) = colors(source)
        assert server.statistics.total("vget /camera/1/lit") <= 2 * pictures + 20
    assert (capture.payload, exposure_of(capture)) == (before.payload, "manual, bias 0")
    assert exposure_of(before) is None


@pytest.mark.parametrize("dialect", ["0.3.10", "M", "N1"])
def test_older_dialects_keep_the_games_own_exposure(dialect):
    with mock_server.serve("four-wall", dialect=dialect, size=(16, 16)) as server:
        for options in ({}, {"exposure": "game"}):
            with omniscv.open_source(server.uri, **options) as source:
                (capture,) = source.capture([Request(VIEWS[0], "lit")])
                assert exposure_of(capture) is None
                with pytest.raises(ServerRefusedError, match="expected a plugin that sets exposure, N2 or"):
                    list(source.capture(requests(("lit", 1))))
        assert not server.statistics.total("vset /camera/1/exposure")
        for wrong in ("auto", 0.0):
            with pytest.raises(ServerRefusedError, match=r"exposure of one camera .* use fix_exposure"):
                omniscv.open_source(server.uri, exposure=wrong)


def test_the_bias_that_matches_the_games_exposure_is_found():
    for faults, bias in (
        (["dark-manual=2.5"], 2.5),
        (["tone=film", "dark-manual=6"], 6),
        (["stale=2", "dark-manual=1"], 1),
        # The four pictures come to middle grey, 127.5, from 136.8 as the scene describes them.
        (["exposure-drift"], np.log2(127.5 / 136.8)),
    ):
        permanent = [fault for fault in faults if not fault.startswith("stale")]
        with mock_server.serve("four-wall", faults=permanent) as server:
            for fault in set(faults) - set(permanent):
                server.faults.start(fault)
            with omniscv.open_source(server.uri) as source:
                first, second = colors(source, count=2)
        assert first.payload == second.payload
        assert float(exposure_of(first).removeprefix("manual, bias ")) == pytest.approx(bias, abs=0.1)


def test_pictures_that_were_measured_are_no_captures():
    """They have the captures' size, and lag, which one picture of depth has not shown yet."""
    views = [View(omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=yaw), 90, 64, 64) for yaw in (10, 50, 90)]
    depths, colors = ([Request(view, mode) for view in views] for mode in ("depth", "lit"))
    with mock_server.serve("four-wall", dialect="N2") as server:
        with omniscv.open_source(server.uri, exposure="game") as source:
            true = [capture.payload for capture in source.capture(colors)]
        server.faults.start("stale=2")
        with omniscv.open_source(server.uri) as source:
            list(source.capture(depths[:1]))
            assert [capture.payload for capture in source.capture(colors)] == true


def test_a_game_that_no_bias_matches_keeps_its_exposure(caplog):
    with mock_server.serve("four-wall") as server, omniscv.open_source(server.uri) as source:
        (true,) = colors(source)
    with (
        caplog.at_level(logging.WARNING, "omniscv"),
        mock_server.serve("four-wall", faults=["dark-manual=20"]) as server,
        omniscv.open_source(server.uri) as source,
    ):
        first, second = colors(source, count=2)
        assert not server.statistics.total(
            "vset /camera/2/illumination"
        )  # the camera that captures is another
        source.close()
        assert len(server.world.cameras) == 1
    assert [first.payload, second.payload] == [true.payload] * 2
    assert exposure_of(first) is None
    (record,) = caplog.records
    assert "colours keep the game's own exposure: no manual exposure matches it" in record.message


def test_replicas_have_one_exposure():
    """The replicas' manual exposures differ by two stops; the first one that captures decides for both."""
    with (
        mock_server.serve("four-wall") as one,
        mock_server.serve("four-wall", faults=["dark-manual=2"]) as other,
        open_sources([one.uri, other.uri]) as pool,
    ):
        captures = list(pool.capture(requests(("lit", None))))
        assert len({capture.provenance["server"] for capture in captures}) == 2
        assert len({exposure_of(capture) for capture in captures}) == 1


def test_recordings_of_one_source_measure_its_exposure_once(tmp_path):
    with mock_server.serve("four-wall") as server, omniscv.open_source(server.uri) as live:
        counts = []
        for name in ("a.sqlite", "b.sqlite"):
            with omniscv.record(SourceView(live), tmp_path / name) as source:
                colors(source)
            counts.append(server.statistics.total("vset /camera/1/size 64 64"))
        assert counts == [1, 1]


@pytest.mark.parametrize("begun", ["auto", "game"])
def test_a_recording_goes_on_with_its_exposure(begun, tmp_path):
    """Of the game that goes on, manual exposure is three stops darker."""
    path = tmp_path / "room.sqlite"
    held = {"auto": "manual, bias 1", "game": None}[begun]
    exposures = []
    for dark, options in ((1, {"exposure": begun}), (4, {})):
        address = f"mock://four-wall?fault=dark-manual={dark}"
        with omniscv.open_source(address, **options) as live, omniscv.record(live, path) as source:
            exposures += map(exposure_of, colors(source, yaw_deg=dark))
    assert exposures == [held] * 2


@pytest.mark.parametrize(
    ("begun", "wanted", "message"),
    [
        (1.0, 2.0, "expected a bias of 1, as recorded before, got a bias of 2; leave exposure out"),
        ("game", 2.0, "expected the game's own, as recorded before, got a bias of 2"),
        (1.0, "game", "expected a bias of 1, as recorded before, got the game's own"),
    ],
)
def test_a_recording_refuses_colours_of_another_exposure(begun, wanted, message, tmp_path):
    def record(exposure, yaw_deg, **options):
        with (
            omniscv.open_source("mock://four-wall", exposure=exposure) as live,
            omniscv.record(live, tmp_path / "room.sqlite", **options) as source,
        ):
            return [exposure_of(capture) for capture in colors(source, yaw_deg=yaw_deg)]

    first = record(begun, 0)
    with pytest.raises(ArgumentError, match=message):
        record(wanted, 30)
    assert record(begun, 60) == first
    assert record(wanted, 0, anew=True) != first


def test_a_game_that_was_started_again_gets_the_same_exposure():
    with (
        mock_server.serve("four-wall", faults=["dark-manual=1"]) as first,
        omniscv.open_source(first.uri) as source,
    ):
        (before,) = colors(source)
        first.stop()
        with mock_server.serve("four-wall", port=first.port, faults=["dark-manual=1.5"]) as second:
            (after,) = colors(source)
            bias = "vset /camera/1/exposure_bias"
            assert second.statistics.total(bias) == second.statistics.total(f"{bias} 1.0") == 1
            assert second.statistics.total("vset /camera/1/illumination lumen") == 1
    assert exposure_of(before) == exposure_of(after) == "manual, bias 1"


def test_a_server_that_refuses_what_it_lists_keeps_its_exposure(caplog):
    change = answering("error no such method", "exposure_method")
    with mock_server.serve("four-wall") as server, relayed(server, change) as uri:
        with omniscv.open_source(uri) as source:
            assert exposure_of(*colors(source)) is None
        assert "no such method" in caplog.text
        with omniscv.open_source(uri, exposure="auto") as source, pytest.raises(ServerRefusedError):
            colors(source)


@pytest.mark.parametrize("bias", ["x", "nan", "1e9", ""])
def test_provenance_that_no_camera_has_is_the_games_exposure(bias):
    assert exposure_from_text(exposure_to_text(-1.25)) == -1.25
    assert exposure_from_text(f"manual, bias {bias}") == "game"


def test_exposure_of_the_command_line_which_is_matched_where_its_first_image_is(tmp_path, capsys):
    base = ["record", "--source", "mock://four-wall", "--modes", "lit", "--set", "face_size=16"]
    out = str(tmp_path / "a.sqlite")
    assert run([*base, "--exposure", "0.5", "--out", out]) == 0
    with omniscv.open_source(out) as source:
        (view, *_) = source.recorded_views()
        (capture,) = source.capture([Request(view, "lit")])
    assert capture.provenance["exposure"] == "manual, bias 0.5"
    for wrong in ("bright", "99", "1,2"):
        assert run([*base, "--exposure", wrong, "--out", out]) == 2
    expected = "--exposure: expected auto, game or a bias in stops such as 0.5, got"
    assert [expected in line for line in capsys.readouterr().err.splitlines()] == [True, False, True]
    with mock_server.serve("four-wall") as server:
        arguments = ["--source", server.uri, "--modes", "lit", "--set", "face_size=16", "--position"]
        assert run(["record", *arguments, "0.5,0.25,1.4", "--out", str(tmp_path / "room.sqlite")]) == 0
        assert server.statistics.total("vset /camera/1/location 50.000000 -25.000000 140.000000")
        assert server.statistics.total("vset /camera/1/exposure_method manual")
