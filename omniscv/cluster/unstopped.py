"""Loaded by workers on this machine: Ctrl-C in a terminal reaches them too, and the command ends them."""

import signal


def dask_setup(worker: object) -> None:
    """Ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
