"""The pytest plugin in other people's projects: tests in files of their own, run by pytest."""

import json
import subprocess
import sys
import textwrap

import pytest
from support.recordings import provenances

import mock_server
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.store import Store

pytest_plugins = "pytester"

HEAD = """
import pytest
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, View

VIEWS = [View(Pose((0, 0, 1.5), R_w_c), 90.0, 16, 16) for _, R_w_c in cube_rotations()]
"""

CAPTURES = """
@pytest.mark.block_network
@pytest.mark.recorded("room.sqlite")
def test_room(recorded_source):
    requests = [Request(view, mode) for mode in {modes} for view in VIEWS]
    assert [capture.request for capture in recorded_source.capture(requests)] == requests
    assert "Layout" in " ".join(recorded_source.objects().names())
"""


@pytest.fixture
def suite(recorded, pytester):
    """Run the tests of a module ``test_room.py``, and check their outcomes.

    pytester forgets the modules that such a run has imported. Numba cannot be imported twice, so the fixture
    ``recorded`` imports it before; else later tests of this process fail.
    """

    def run(source, *options, **outcomes):
        pytester.makepyfile(test_room=HEAD + textwrap.dedent(source))
        result = pytester.runpytest_inprocess("-p", "no:cacheprovider", *options)
        result.assert_outcomes(**outcomes)
        return result

    return run


@pytest.fixture
def record(pytester):
    return pytester.path / "captures" / "test_room" / "room.sqlite"


def times(path):
    found = {}
    for mode, provenance in provenances(path):
        found.setdefault(mode, []).append(provenance["time"])
    return found


def test_an_argument_that_a_marker_does_not_take_is_one_line(suite):
    cases = (
        ("unreal_server", "unreal(sice=(8, 8))", "unexpected keyword argument 'sice'"),
        ("unreal_server", "unreal('six-wall', 'N1')", "expected (scene='four-wall', **options)"),
        ("unreal_server", "unreal(3)", "unreal: *str"),
        ("recorded_source", "recorded(path='a')", "expected (file=None), got others"),
    )
    tests = (f"@pytest.mark.{mark}\ndef test_{i}({of}): pass\n" for i, (of, mark, _) in enumerate(cases))
    result = suite("".join(tests), errors=len(cases))
    result.stdout.fnmatch_lines([f"*@pytest.mark.*{says}*" for *_, says in cases])


def test_markers_take_their_arguments_by_position_and_by_name(suite):
    suite(
        """
        @pytest.mark.unreal("six-wall", size=(16, 16))
        def test_name(unreal_server):
            assert unreal_server.uri

        @pytest.mark.unreal({"objects": {"Ball": {"solids": [{"sphere": 0.5, "at": [2, 0, 1]}]}}})
        def test_description(unreal_server):
            from omniscv import open_source
            with open_source(unreal_server.uri) as source:
                assert source.objects().names() == ["Ball"]

        @pytest.mark.recorded
        def test_room(recorded_source):
            list(recorded_source.capture([Request(VIEWS[0], "lit")]))

        @pytest.mark.recorded(file="other.sqlite")
        def test_other(recorded_source):
            list(recorded_source.capture([Request(VIEWS[0], "lit")]))

        def test_files(recorded_dir):
            assert {path.name for path in recorded_dir.iterdir()} == {"test_room.sqlite", "other.sqlite"}
        """,
        "--record-mode=once",
        passed=5,
    )
    suite(
        """
        @pytest.mark.unreal("moon")
        def test_scene(unreal_server):
            pass
        """,
        errors=1,
    ).stdout.fnmatch_lines(["@pytest.mark.unreal: scene: expected *four-wall*"])


def test_contracts_for_a_package(suite):
    suite(
        """
        from omniscv import cameras, open_source
        from omniscv.testing import check_camera, check_source

        def test_wrong_camera():
            class Shifted(cameras.model("equirectangular")):
                def _project(self, points):
                    pixels, valid = super()._project(points)
                    return pixels + 1e-4, valid
            with pytest.raises(AssertionError):
                check_camera(Shifted(32, 16))

        def test_wrong_source():
            from omniscv.sources import SourceWrapper
            class Disordered(SourceWrapper):
                def capture(self, requests):
                    yield from super().capture(reversed(list(requests)))
            with Disordered(open_source("scene://four-wall")) as source, pytest.raises(AssertionError):
                check_source(source)
        """,
        passed=2,
    )


FAILS = CAPTURES.format(modes=["lit", "depth"]) + "    assert False\n"
SKIPS = CAPTURES.format(modes=["lit", "depth"]) + "    pytest.skip('not today')\n"


def test_once_replays_new_episodes_adds_and_all_records_again(suite, record):
    """A test that does not pass, or finds no server, neither creates nor changes a recording."""
    lit, both = (CAPTURES.format(modes=modes) for modes in (["lit"], ["lit", "depth"]))
    once = "--record-mode=once"
    anew = "--record-mode=all"
    result = suite(lit, errors=1)
    result.stdout.fnmatch_lines(["*room.sqlite: expected a recording; make it with --record-mode=once*"])
    suite(FAILS, once, failed=1)
    assert not record.parent.exists() or list(record.parent.iterdir()) == []
    suite(lit, once, passed=1)
    before = record.read_bytes()
    first = times(record)
    suite(lit, passed=1)
    result = suite(both, once, failed=1)
    result.stdout.fnmatch_lines(["*MissingCaptureError*the recording holds no depth, only lit*"])
    suite(FAILS, anew, failed=1)
    suite(SKIPS, anew, skipped=1)
    suite(lit, "--record-mode=rewrite", "--unrealcv=127.0.0.1:1", errors=1)
    assert record.read_bytes() == before
    assert list(record.parent.iterdir()) == [record]
    suite(both, "--record-mode=new_episodes", passed=1)
    second = times(record)
    assert second["lit"] == first["lit"]
    assert len(second["depth"]) == 6
    suite(lit, anew, passed=1)
    assert times(record)["depth"] == second["depth"]
    assert min(times(record)["lit"]) > max(second["lit"])


@pytest.mark.parametrize("left", ["an empty file", "no captures"])
def test_once_records_where_a_recording_holds_nothing(left, suite, record):
    record.parent.mkdir(parents=True)
    if left == "an empty file":
        record.touch()
    else:
        Store(record, write=True).close()
    suite(CAPTURES.format(modes=["lit"]), "--record-mode=once", passed=1)
    assert verify(record).captures == 6


def test_a_running_game_is_recorded(suite, record):
    with mock_server.serve("six-wall") as game:
        address = f"--unrealcv=127.0.0.1:{game.port}"
        suite(CAPTURES.format(modes=["lit"]), "--record-mode=once", address, passed=1)
        assert game.statistics.total("vget /camera/") >= 6
    suite(CAPTURES.format(modes=["lit"]), passed=1)


def test_a_file_is_named_after_its_test_unless_told(suite, pytester):
    suite(
        """
        from pathlib import Path

        @pytest.fixture(scope="module")
        def recorded_dir():
            return Path(__file__).parent / "kept"

        @pytest.mark.parametrize("mode", ["lit", "depth"])
        def test_face(recorded_source, mode):
            [capture] = recorded_source.capture([Request(VIEWS[0], mode)])
        """,
        "--record-mode=once",
        passed=2,
    )
    names = sorted(file.name for file in (pytester.path / "kept").iterdir())
    assert names == ["test_face[depth].sqlite", "test_face[lit].sqlite"]


LIGHT = """
import json, sys
import pytest
import omniscv, omniscv.testing
pytest.main(["-q", "-p", "no:cacheprovider"])
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""
HEAVY = {"numba", "cv2", "scipy", "matplotlib", "OpenImageIO", "numpy", "yaml", "unrealcv", "mock_server"}


def test_it_loads_nothing_heavy_into_other_projects(pytester):
    pytester.makepyfile("def test_nothing(pytestconfig): assert pytestconfig.getoption('--unrealcv') is None")
    done = subprocess.run(
        [sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True, timeout=120
    )
    assert "1 passed" in done.stdout
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert "omniscv" in loaded
    assert loaded & HEAVY == set()
