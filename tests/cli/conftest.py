"""A job in the present folder, for options beside it and commands that take it."""

import pytest

JOB = """
source: mock://four-wall
cameras: {pano: {model: equirectangular, width: 64, height: 32}}
poses: [{position: [0, 0, 1.5], yaw_deg: 40}]
modes: [lit, mask]
face_size: 32
"""


@pytest.fixture
def job(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "job.yaml"
    path.write_text(JOB)
    return path
