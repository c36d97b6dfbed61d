"""numba's decorator: the mock server's, which imports nothing of omniscv."""

from mock_server.compiled import njit

__all__ = ["njit"]
