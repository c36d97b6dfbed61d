"""A folder like the repository's for documents to run in, and servers at the addresses that they name."""

import shutil
import warnings
from contextlib import ExitStack

import pytest
from support.command_line import ROOT

import mock_server


@pytest.fixture(scope="module")
def ports():
    """The ports of documents, and those of mock servers that run."""
    with ExitStack() as servers:
        first, second = (servers.enter_context(mock_server.serve("four-wall", size=(160, 120))) for _ in "12")
        yield {9000: first.port, 9001: second.port}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder with a copy of captures/, which documents may write to; the present one."""
    shutil.copytree(ROOT / "captures", tmp_path / "captures")
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        # The official client's: every public server is too old for its question about commands.
        warnings.filterwarnings("ignore", message=".*too old to report", category=UserWarning)
        yield tmp_path
