"""Object stores that lie about names, sizes and bytes, and fail in ways of their own."""

import errno
import random

import fsspec
from fsspec.implementations.memory import MemoryFileSystem

from attack.commands import clear, nothing_left, require
from attack.datasets import contents, made
from omniscv import dataset, storage
from omniscv.errors import OmniscvError
from omniscv.storage import remote

FAILURES = [
    lambda: ConnectionResetError(errno.ECONNRESET, "reset"),
    lambda: PermissionError("denied\nfor https://user:secret@host/x?token=secret"),
    lambda: FileNotFoundError("it was here"),
    lambda: OSError(errno.ENOSPC, "No space left on device"),
    lambda: TimeoutError(),
    lambda: ValueError("\x1b[31m" + "x" * 10_000),
    lambda: KeyError("Body"),
    lambda: RuntimeError(),
    lambda: UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    lambda: RecursionError("maximum recursion depth exceeded"),
]
NAMES = ["../x", "/etc/passwd", "a//b", "", ".", "\x00", "a\\b", "\ud800.json", "\x1b[31m.json", "x" * 5000]


class LyingStore(MemoryFileSystem):
    """A store in memory of its own, whose answers are drawn."""

    protocol = "lying"
    store = {}  # noqa: RUF012 - as fsspec has it
    pseudo_dirs = [""]  # noqa: RUF012
    rng = random.Random(0)
    share = 0.0

    def _answer(self, value, lie):
        """Return a value, or a lie about it; or fail."""
        if self.rng.random() >= self.share:
            return value
        if self.rng.random() < 0.5:
            raise self.rng.choice(FAILURES)()
        return lie(value)

    def info(self, path, **options):
        sizes = [-1, 0, 1, 2**63, None, "1"]
        info = super().info(path, **options)
        return self._answer(info, lambda info: {**info, "size": self.rng.choice(sizes)})

    def find(self, path, *values, **options):
        strange = [f"{path}/{name}" for name in self.rng.sample(NAMES, 3)]
        return self._answer(super().find(path, *values, **options), lambda found: [*found[::2], *strange])

    def get_file(self, rpath, lpath, *values, **options):
        super().get_file(rpath, lpath, *values, **options)
        with open(lpath, "rb") as file:
            right = file.read()
        lies = [right[:-1], right + b"x", b"", right[::-1], b"{}", b"[" * 10_000]
        given = self._answer(right, lambda _: self.rng.choice(lies))
        if given is not right:
            with open(lpath, "wb") as file:
                file.write(given)


def case(rng, folder):
    """What comes from such a store is what was put there, or a refusal; nothing else is kept or written."""
    fsspec.register_implementation("lying", LyingStore, clobber=True)
    LyingStore.store.clear()
    LyingStore.rng = rng
    LyingStore.share = 0.0
    waits = remote._FIRST_WAIT_S
    remote._FIRST_WAIT_S = 0.0
    out, right = made()
    with nothing_left(folder) as work:
        there = storage.folder("lying://held/room")
        for path in out.iterdir():
            if path.is_file():
                there.put(path.name, path)
        LyingStore.share = rng.choice([0.05, 0.2, 0.6])
        try:
            for action in (read, check, export, put):
                try:
                    action(rng, there, work, right)
                except OmniscvError as error:
                    clear(error)
                    require("secret" not in str(error), f"a secret is shown: {error}")
        finally:
            remote._FIRST_WAIT_S = waits
        left = {each.name for each in work.iterdir()}
        require(left <= {"coco"}, f"files are left: {left}")


def read(rng, there, work, right):
    frames = dataset.open(there)
    for key, content in contents(rng.sample(frames, min(2, len(frames)))):
        require(right[key] == content, f"other data than was put: {key}")


def check(rng, there, work, right):
    for line in dataset.check(there, deep=True):
        require("\n" not in line, f"a fault of several lines: {line}")


def export(rng, there, work, right):
    dataset.export(there, "coco", work / "coco")


def put(rng, there, work, right):
    there.put("new", b"new", first=rng.random() < 0.5)
    LyingStore.share = 0.0
    require(there.read("new") == b"new", "put says that it wrote, and did not")
