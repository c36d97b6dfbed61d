"""Pictures by shared memory: the same as over the wire, never one that was overwritten, off where refused."""

import json

import numpy as np
import pytest
from support.faces import face_requests
from support.unreal import MODES

import mock_server
import omniscv
from omniscv.errors import BadReplyError
from omniscv.sources import Request, View
from omniscv.sources.unreal import modern
from omniscv.sources.unreal.shared_memory import SharedPictures

SIZE = 24
VIEWS = [
    View(omniscv.Pose.from_angles((0, 0, 1.5), yaw), 90.0, *px) for yaw, px in ((10, (40, 30)), (50, (64, 8)))
]
REQUESTS = face_requests(SIZE, MODES) + [Request(view, mode) for view in VIEWS for mode in MODES]


@pytest.fixture
def windows(monkeypatch):
    """Serve a scene with regions, which this process reads as if it were on the same Windows machine."""
    servers = []

    def read(name, size):
        data = servers[-1].regions.get(name, b"")
        if len(data) < size:
            raise OSError(f"there is no region {name} of {size} bytes")
        return bytes(data[:size])

    def start(shared_memory="serving", **options):
        servers.append(
            mock_server.serve("four-wall", shared_memory=shared_memory, size=(SIZE, SIZE), **options)
        )
        return servers[-1]

    monkeypatch.setattr(modern, "region_reader", lambda endpoint: read)
    yield start
    for server in servers:
        server.stop()


def captures(source):
    return [(capture.pixels, capture.view) for capture in source.capture(REQUESTS)]


def same(ones, others):
    return all(np.array_equal(a[0], b[0]) and a[1] == b[1] for a, b in zip(ones, others, strict=True))


def test_pictures_are_those_of_the_wire_and_recordings_keep_them(windows, tmp_path):
    server, path = windows(), tmp_path / "room.sqlite"
    with omniscv.open_source(f"mock://four-wall?size={SIZE}x{SIZE}") as wire:
        wanted = captures(wire)
    with omniscv.record(omniscv.open_source(server.uri, exposure="game"), path) as source:
        made = captures(source)
        assert source.objects().names()
    assert same(made, wanted)
    with omniscv.open_source(path) as again:
        assert same(captures(again), wanted)
    pngs = server.statistics.total("vget /camera/1/lit png") + server.statistics.total(
        "vget /camera/1/depth npy"
    )
    assert (pngs, server.statistics.total("vget /camera/1/lit_shared") >= len(REQUESTS) / 4) == (0, True)


@pytest.mark.parametrize("setting", ["refusing", "unlisted"])
def test_where_it_is_refused_or_unlisted_pictures_come_over_the_wire(windows, setting):
    server = windows(setting)
    with omniscv.open_source(server.uri) as source:
        list(source.capture(REQUESTS[:4]))
    assert server.statistics.total("vget /camera/1/lit png") > 0
    assert server.statistics.total("vget /camera/1/object_mask_shared") == (1 if setting == "refusing" else 0)


def test_regions_of_another_process_are_not_believed(windows, monkeypatch):
    """A reader that finds black pictures, as Python's mmap makes them for a wrong name."""
    monkeypatch.setattr(modern, "region_reader", lambda endpoint: lambda name, size: bytes(size))
    server = windows()
    with omniscv.open_source(server.uri) as source:
        (capture,) = source.capture(REQUESTS[:1])
    assert capture.pixels.any()
    assert server.statistics.total("vget /camera/1/lit_shared") == 0


def test_a_region_that_is_gone_switches_it_off_and_pictures_come_over_the_wire(windows, monkeypatch):
    server, gone = windows(), []

    def read(name, size):
        if gone:
            raise OSError(f"there is no region {name}")
        return bytes(server.regions[name][:size])

    monkeypatch.setattr(modern, "region_reader", lambda endpoint: read)
    with omniscv.open_source(server.uri, exposure="game") as source:
        wanted = captures(source)
        gone.append(True)
        sent = server.statistics.total("vget /camera/1/lit png")
        assert same(captures(source), wanted)
        assert server.statistics.total("vget /camera/1/lit png") > sent == 0


def answer(**changes):
    known = {"name": "UnrealCV_1_camera_0_depth_float32_v1", "modality": "depth", "dtype": "float32",
             "num_bytes": 8, "offset_bytes": 0, "frame": 1, "shape": [1, 2]}  # fmt: skip
    return json.dumps(known | changes)


@pytest.mark.parametrize(
    ("reply", "says"),
    [
        ("error Windows shared memory transport is only available on Windows", "expected a region"),
        (b"\x89PNG", "expected a region"),
        ("[" * 10_000, "expected a region"),
        (answer(frame=0), "expected a new capture .* got number 0 again"),
        (answer(name="UnrealCV_1/../x"), "expected a picture of UnrealCV"),
        (answer(num_bytes=1 << 40, shape=[1 << 19, 1 << 19]), "expected a picture of UnrealCV"),
        (answer(shape=[1, 3]), "expected a picture of UnrealCV"),
        (answer(shape=[-1, -2]), "expected a picture of UnrealCV"),
        (answer(offset_bytes=4), "expected a picture of UnrealCV"),
        (answer(dtype="object"), "expected a picture of UnrealCV"),
        (answer(shape=[]), "expected a"),
    ],
)
def test_replies_that_are_no_region_are_bad(reply, says):
    with pytest.raises(BadReplyError, match=says):
        SharedPictures(lambda name, size: bytes(size)).payload(reply)


def test_a_capture_is_read_once():
    pictures = SharedPictures(lambda name, size: np.float32([100, 200]).tobytes())
    assert pictures.payload(answer()).endswith(np.float32([100, 200]).tobytes())
    with pytest.raises(BadReplyError, match="got number 1 again"):
        pictures.payload(answer())
