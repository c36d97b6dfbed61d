"""One small dataset, which tests copy before they change it."""

import shutil

import pytest
from support.datasets import made


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The folder of a job and its dataset: two cameras, three poses, classes, splits, times, places."""
    folder = tmp_path_factory.mktemp("whole")
    made(folder, more="export: [webdataset]\n")
    return folder


@pytest.fixture
def copied(whole, tmp_path):
    shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    return tmp_path / "dataset"
