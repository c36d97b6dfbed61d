"""Folders that nobody may write to, whoever runs the tests."""

import contextlib
import os


@contextlib.contextmanager
def read_only(folder):
    """Make a folder read-only; root may write anywhere, so it becomes nobody for a while."""
    folder.chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o755)
