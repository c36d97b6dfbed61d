"""A small recording of the four-wall room, made once, and a folder for it."""

import tempfile
from pathlib import Path

import pytest
from support.faces import face_requests

import omniscv


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorded") / "room.sqlite"
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        source.objects()
        list(source.capture(face_requests()))
    return path


@pytest.fixture
def copy(recorded, tmp_path):
    """A copy that a test may spoil."""
    path = tmp_path / "copy.sqlite"
    path.write_bytes(recorded.read_bytes())
    return path


@pytest.fixture
def open_folder():
    """A folder that other users can reach, which a test's own is not."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder
