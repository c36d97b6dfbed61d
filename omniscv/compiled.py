"""numba's decorator with a cache that loads quickly: the mock server's, which imports nothing of omniscv."""

from mock_server.compiled import inner, njit

__all__ = ["inner", "njit"]
