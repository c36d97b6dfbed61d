"""Addresses: the schemes of this package and of others, and one clear sentence for what is none."""

import numpy as np
import pytest
from PIL import Image

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.cli import run
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError, NotARecordingError, SourceError
from omniscv.geometry import Pose
from omniscv.sources import Capabilities, ObjectTable, registry
from omniscv.sources.registry import split_address
from omniscv.sources.scene import SceneSource


@pytest.fixture(autouse=True)
def openers(monkeypatch):
    monkeypatch.setattr(registry, "_openers", dict(registry._openers))


WRONG = {
    "localhost:9000": r"expected an address or a recording, got 'localhost:9000'; write unreal://localhost:9000",
    "192.168.0.7:9000": "write unreal://192.168.0.7:9000",
    "[::1]:9000": r"write unreal://\[::1\]:9000",
    "http://localhost": r"expected blender://, .*launch:, .*mock://, .*scene://.*, unreal\+unix://.*got 'http://localhost'",
    "": "expected an address or the path of a recording, got ''",
    "unreal://": "expected unreal://host:port",
    "unreal://host:nine": "expected unreal://host:port",
    "mock://moon": "expected one of .*four-wall.*got 'moon'",
    "mock://four-wall?speed=3": "expected options among .*latency_ms.* got 'speed'",
    "mock://workshop?time_step_s=-1": "time_step_s: expected a number from 0 to 3600, got -1.0",
    "mock://four-wall?latency_ms=fast": "expected a value of latency_ms, got 'fast'",
    "scene://moon": "scene://moon.*expected one of .*four-wall",
    "scene://": "expected one of .*four-wall",
    "scene://four-wall?lit=double": "lit: expected one of uint8, float32; got 'double'",
    "scene://four-wall?masks=red": "masks: expected one of colors, ids; got 'red'",
    "scene://four-wall?size=3": "expected options among lit, masks, time, traces .*got 'size'",
    **dict.fromkeys((None, 9000, b"room.sqlite", ("mock://four-wall",)), "expected an address or the path"),
}


@pytest.mark.parametrize("address", WRONG)
def test_what_is_no_address_is_one_clear_sentence(address):
    with pytest.raises(ArgumentError, match=WRONG[address]) as error:
        omniscv.open_source(address)
    assert "\n" not in str(error.value)


class TwiceNumbered(SceneSource):
    """A source of rays whose masks number objects in another order than its labels do."""

    def objects(self):
        names = super().objects().names()
        return ObjectTable({}, ids={name: len(names) - rank for rank, name in enumerate(names)})


@pytest.mark.rays
def test_a_source_of_rays_with_two_numberings_is_refused_when_it_is_opened_and_when_it_is_rendered():
    source = TwiceNumbered(load_scene("four-wall"), Capabilities(traces=True), masks="ids")
    registry.register("twice", lambda address: source)
    says = "source: expected ids that count the names in sorted order from 1 .* whose label is"
    with pytest.raises(ArgumentError, match=says):
        Renderer(source)
    with pytest.raises(ArgumentError, match=says):
        omniscv.open_source("twice://")


def test_what_is_no_recording_is_one_clear_sentence(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing " * 100)
    for name, says in (("", "a folder"), ("none.sqlite", "nothing there"), ("notes.txt", "not a database")):
        with pytest.raises(NotARecordingError, match=f"expected a recording, got .*{says}"):
            omniscv.open_source(tmp_path / name)


PICTURES = {"R.JPG": "JPEG", "wall.png": "PNG", "wall.tiff": "TIFF", "wall.webp": "WebP", "wall.bmp": "BMP"}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_named_with_the_command_that_makes_a_recording_of_it(name, tmp_path, capsys):
    """The command as it is printed, and then the one that was refused, of the recording."""
    file = tmp_path / name
    Image.new("RGB", (64, 32), (200, 90, 30)).save(file, PICTURES[name])
    with pytest.raises(
        NotARecordingError, match=f"got a {PICTURES[name]} picture; write 'omniscv"
    ) as refused:
        omniscv.open_source(file)
    words = refused.value.reason.split("write 'omniscv ")[1].split("', and")[0].split()
    words[words.index(f"{file.stem}.sqlite")] = str(tmp_path / "made.sqlite")
    assert run(words) == 0
    with omniscv.open_source(tmp_path / "made.sqlite") as source:
        image = omniscv.render(create("pinhole", 16, 16, fov_deg=60), Pose.from_angles((0, 0, 1.5)), source)
    assert np.abs(image.lit.astype(int) - (200, 90, 30)).max() <= 8


def test_a_file_whose_name_looks_like_an_address_is_a_file(recorded, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room:1").write_bytes(recorded.read_bytes())
    with omniscv.open_source("room:1") as replay:
        assert len(replay.recorded_views()) == 6


def test_options_go_to_the_opener():
    opened = []
    registry.register("mits", lambda address, *, samples=64: opened.append((address, samples)))
    for options in ({}, {"samples": 4}):
        with pytest.raises(ArgumentError, match=r"expected it to return a Source for 'mits://a', got None"):
            omniscv.open_source("mits://a", **options)
    assert opened == [("mits://a", 64), ("mits://a", 4)]


def test_what_cannot_be_registered_and_what_an_opener_raises():
    for scheme, opener, says in (
        ("a b", print, "scheme: expected a name"),
        (None, print, "scheme: expected"),
        ("mine", "open", "opener: expected"),
    ):
        with pytest.raises(ArgumentError, match=says):
            registry.register(scheme, opener)
    registry.register("broken", lambda address: None + 1)
    with pytest.raises(TypeError, match="unsupported operand"):
        omniscv.open_source("broken://here")


def test_options_of_an_address():
    found = split_address("game://a/b?n=3&tag=x&tag=y", {"n": int, "tag": str}, repeatable=("tag",))
    assert found == ("a/b", {"n": 3, "tag": ["x", "y"]})


def test_an_entry_point_that_is_gone_is_one_clear_sentence(tmp_path, monkeypatch):
    installed = tmp_path / "omniscv_mitsuba-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: omniscv-mitsuba\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text("[omniscv.sources]\ngone = json:removed\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert {"gone", "mock", "unreal"} <= set(omniscv.sources.schemes())
    with pytest.raises(SourceError, match=r"gone://x: expected the entry point 'json:removed'"):
        omniscv.open_source("gone://x")
    with pytest.raises(ArgumentError, match=r"expected blender://, (\S+, )*gone://, launch:, .*mock://"):
        omniscv.open_source("mits://x")
