"""A small recording of the four-wall room, made once, and a folder for it."""

import tempfile
from pathlib import Path

import pytest
from support.faces import face_requests
from support.recordings import filled


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    return filled(tmp_path_factory.mktemp("recorded") / "room.sqlite", face_requests(), "mock://four-wall")


@pytest.fixture(scope="session")
def other(tmp_path_factory):
    requests = face_requests(modes=("lit", "object_mask"), center=(0.3, 0.0, 1.5))
    return filled(tmp_path_factory.mktemp("other") / "other.sqlite", requests, "mock://six-wall")


@pytest.fixture
def copy(recorded, tmp_path):
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
