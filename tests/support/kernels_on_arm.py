"""Compares kernels of ARM in an emulator with those of this processor: run by scripts/test-arm."""

import copy
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from mock_server.compiled import load_library, symbol
from mock_server.signatures import ArrayType, TupleType, Type
from support.kernel_calls import Call, recorded_calls

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("mock_server", "omniscv")
MOST_ULP = 2


def main(folder: Path) -> int:
    """Call each kernel on both processors with equal arguments; print those that differ."""
    worst: dict[str, int] = {}
    calls = recorded_calls()
    for package in PACKAGES:
        load_library(package)
        own = [call for call in calls if call[0].full_name.startswith(f"{package}.")]
        packed = [Packed(call) for call in own]
        (folder / "calls").write_bytes(b"".join(call.file_bytes() for call in packed))
        library = ROOT / package / "kernels" / "linux-aarch64.so"
        command = ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu", folder / "call", library]
        subprocess.run([*command, folder / "calls", folder / "results"], check=True)
        results = (folder / "results").read_bytes()
        for call in packed:
            results = call.compare(results, worst)
    for name, ulp in sorted(worst.items()):
        print(f"{name}: {ulp} units in the last place" if ulp else f"{name}: equal bytes")
    equal = sum(ulp == 0 for ulp in worst.values())
    print(f"{len(calls)} calls, {equal} of {len(worst)} kernels with equal bytes")
    return int(max(worst.values()) > MOST_ULP)


class Packed:
    """A call with its arrays in one block of bytes, in which addresses are offsets."""

    def __init__(self, call: Call) -> None:
        self.kernel, self.index, args = call
        self.signature = self.kernel.signatures[self.index]
        self.arrays: list[np.ndarray[Any, Any]] = []
        contiguous = copy.deepcopy(args)
        words: list[Any] = []
        assert self.signature.pack(contiguous, words, self.arrays)
        self.arrays = list(_arrays(self.signature.arguments, contiguous))
        self.starts: list[int] = []
        size = 0
        for array in self.arrays:
            self.starts.append(size)
            size += -(-array.nbytes // 64) * 64 + 64
        self.block = bytearray(size)
        for start, array in zip(self.starts, self.arrays, strict=True):
            self.block[start : start + array.nbytes] = array.tobytes()
        self.args = contiguous
        self.words = words
        self.buffer = bytes(self.signature.buffer(words))

    def file_bytes(self) -> bytes:
        """Return the call as the program in C reads it."""
        name = symbol(self.kernel.full_name, self.index).encode() + b"\0"
        pointers = b""
        for at, start in zip(_addresses(self.signature.arguments, 8), self.starts, strict=True):
            pointers += struct.pack("<QQ", at, start)
        parts = [struct.pack("<Q", len(name)), name, struct.pack("<Q", len(self.buffer)), self.buffer]
        parts += [struct.pack("<Q", len(self.block)), bytes(self.block)]
        return b"".join([*parts, struct.pack("<Q", len(self.starts)), pointers])

    def compare(self, results: bytes, worst: dict[str, int]) -> bytes:
        """Note how far the emulator's results are off ours; return the results of the calls behind."""
        (status,) = struct.unpack_from("<q", results)
        assert status == 0, self.kernel.full_name
        there = results[8 : 8 + len(self.buffer)]
        block = results[8 + len(self.buffer) : 8 + len(self.buffer) + len(self.block)]
        ours = self.kernel.built[self.index].run(self.words)
        theirs = self.signature.result(there)
        ulp = _apart(np.atleast_1d(np.asarray(ours, object)), np.atleast_1d(np.asarray(theirs, object)))
        for start, array in zip(self.starts, self.arrays, strict=True):
            other = np.frombuffer(block, array.dtype, array.size, start).reshape(array.shape)
            for name in array.dtype.names or (None,):
                ulp = max(
                    ulp,
                    _apart(array if name is None else array[name], other if name is None else other[name]),
                )
        worst[self.kernel.full_name] = max(ulp, worst.get(self.kernel.full_name, 0))
        return results[8 + len(self.buffer) + len(self.block) :]


def _arrays(type_: Type, value: Any) -> Any:
    """Yield the arrays of arguments in the order of their addresses."""
    if isinstance(type_, ArrayType):
        yield value
    elif isinstance(type_, TupleType):
        for item, inner in zip(value, type_.items, strict=True):
            yield from _arrays(inner, item)


def _addresses(type_: Type, at: int) -> Any:
    """Yield where the addresses of arrays stand in a buffer of arguments, bytes."""
    if isinstance(type_, ArrayType):
        yield at + 8 * 4
    elif isinstance(type_, TupleType):
        for inner in type_.items:
            yield from _addresses(inner, at)
            at += struct.calcsize("<" + inner.code)


def _apart(ours: Any, theirs: Any) -> int:
    """Return the largest difference in units in the last place; of whole numbers, their difference."""
    if ours.dtype == object:
        ours, theirs = (
            np.array([0 if item is None else item for item in values]) for values in (ours, theirs)
        )
    if ours.dtype.kind == "f":
        equal = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
        step = np.spacing(np.maximum(np.abs(ours), np.abs(theirs)))
        with np.errstate(invalid="ignore"):
            off = np.where(equal, 0, np.abs(ours - theirs) / step)
        return int(np.ceil(np.nan_to_num(off, nan=np.inf, posinf=1e9).max(initial=0)))
    return int(np.abs(ours.astype(np.int64) - theirs.astype(np.int64)).max(initial=0))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
