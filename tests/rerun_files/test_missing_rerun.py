"""Without Rerun one line names what to install."""

import sys

import pytest

from omniscv.errors import ArgumentError
from omniscv.viewing import rerun_file


def test_a_missing_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ArgumentError, match=r"pip install 'omniscv\[rerun\]'"):
        rerun_file.write([], tmp_path / "room.rrd")


def test_another_name_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"expected a file NAME.rrd, got 'room.html'"):
        rerun_file.write([], tmp_path / "room.html")
