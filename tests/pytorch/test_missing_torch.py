"""Without PyTorch, one line names what to install."""

import importlib
import sys

import pytest

from omniscv.errors import OmniscvError


def test_the_extra_is_named(monkeypatch):
    for name in [each for each in sys.modules if each.startswith("omniscv.torch")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)  # as if it were not installed
    with pytest.raises(OmniscvError, match=r"expected PyTorch, got none; .*pip install 'omniscv\[torch\]'"):
        importlib.import_module("omniscv.torch")
