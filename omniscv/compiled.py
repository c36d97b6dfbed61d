"""Kernels (:mod:`mock_server.compiled`): the mock server has some, too, and imports nothing of omniscv."""

from mock_server.compiled import Kernel, fields, load_library, njit

__all__ = ["Kernel", "fields", "load_library", "njit"]
