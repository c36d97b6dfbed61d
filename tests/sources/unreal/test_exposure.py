"""Colours at other exposures: commands, captures of their own, dialects that cannot."""

import pytest

import mock_server
import omniscv
from omniscv.cli import run
from omniscv.errors import ArgumentError, ServerRefusedError
from omniscv.sources import Request, View

VIEWS = [View(omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=yaw), 90, 16, 16) for yaw in (0, 90)]


def requests(*stops):
    return [Request(view, mode, stops=at) for view in VIEWS for mode, at in stops]


@pytest.fixture
def server():
    with mock_server.serve("four-wall", dialect="N2") as server:
        yield server


def test_exposure_is_set_where_colours_need_another_one(server):
    with omniscv.open_source(server.uri) as source:
        list(source.capture(requests(("lit", None), ("depth", None))))
        assert not server.statistics.total("vset /camera/1/exposure")
        made = requests(("lit", -2), ("depth", None), ("lit", 2))
        assert [capture.request for capture in source.capture(made)] == made
        bias = "vset /camera/1/exposure_bias"
        assert [server.statistics.total(f"{bias} {stops}") > 0 for stops in (-2, 2, 0)] == [True, True, False]
        list(source.capture(requests(("lit", None))))
        assert server.statistics.total(f"{bias} 0") == 1


def test_exposures_are_captures_of_their_own(server, tmp_path):
    made, path = requests(("lit", -2), ("depth", None), ("lit", 0.5)), tmp_path / "room.sqlite"
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


def test_a_dialect_without_exposure_refuses():
    with (
        omniscv.open_source("mock://four-wall?dialect=N1") as source,
        pytest.raises(ServerRefusedError, match="expected a plugin that sets exposure, N2 or later"),
    ):
        list(source.capture(requests(("lit", 1))))


@pytest.mark.parametrize(("mode", "stops"), [("depth", 1), ("lit", 21), ("lit", float("nan"))])
def test_stops_are_of_colours_and_bounded(mode, stops):
    with pytest.raises(ArgumentError, match="stops: expected none, or -20 to 20 of lit"):
        Request(VIEWS[0], mode, stops=stops)
