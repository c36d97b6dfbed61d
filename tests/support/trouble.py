"""A source that makes trouble, for the processes of workers: installed beside the package by PYTHONPATH.

``trouble://WHAT,WHAT`` is the room of ``scene://four-wall`` with ``dies@X`` (the process ends at its first
capture with x beyond X), ``fails@X`` (a SourceError there), ``full@NAME`` (a full disk at the worker of that
name), ``freezes@NAME`` (its process stops).
"""

import os
import textwrap

_MODULE = """
import errno
import os
import signal

from omniscv.errors import ServerConnectionError
from omniscv.sources.base import SourceWrapper
from omniscv.sources.registry import open_source


class Trouble(SourceWrapper):
    def __init__(self, address):
        super().__init__(open_source("scene://four-wall"))
        self._kinds = dict(each.split("@") for each in address.partition("://")[2].split(","))

    def capture(self, requests):
        for request in requests:
            self._make_trouble(request.view.pose.position[0])
            yield from super().capture([request])

    def _make_trouble(self, x):
        from distributed import get_worker

        if x > float(self._kinds.get("dies", "inf")):
            os._exit(9)
        if x > float(self._kinds.get("fails", "inf")):
            raise ServerConnectionError(f"nothing at {x:.3f}")
        try:
            name = str(get_worker().name)
        except ValueError:
            return
        if name == self._kinds.get("full"):
            raise OSError(errno.ENOSPC, "No space left on device", "/tmp/capture")
        if name == self._kinds.get("freezes"):
            os.kill(os.getpid(), signal.SIGSTOP)
"""


def environment(folder, version=None):
    """The environment of processes that find the source; with ``version``, the package is said to be that."""
    (folder / "trouble.py").write_text(textwrap.dedent(_MODULE), encoding="utf-8")
    info = folder / "trouble-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: trouble\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[omniscv.sources]\ntrouble = trouble:Trouble\n")
    if version:
        own = folder / f"omniscv-{version}.dist-info"
        own.mkdir(exist_ok=True)
        (own / "METADATA").write_text(f"Metadata-Version: 2.1\nName: omniscv\nVersion: {version}\n")
    return {**os.environ, "PYTHONPATH": str(folder)}
