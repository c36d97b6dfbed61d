"""Kernels: libraries have the code of the sources, and what they lack is compiled by numba."""

import copy
import ctypes
import hashlib
import json
import logging
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.kernel_calls import recorded_calls

import mock_server
import omniscv
from mock_server import compiled, signatures

ROOT = Path(omniscv.__file__).parents[1]
PACKAGES = {"omniscv": omniscv, "mock_server": mock_server}


needs_numba = pytest.mark.skipif(find_spec("numba") is None, reason="numba is needed to compile kernels")


def declared(package):
    """Return the kernels of a package that declare signatures, by their full names."""
    kernels = {}
    for path in sorted(Path(PACKAGES[package].__file__).parent.rglob("*.py")):
        if "\n@njit(" in path.read_text():
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            __import__(module)
            found = (
                value for value in vars(sys.modules[module]).values() if isinstance(value, compiled.Kernel)
            )
            kernels |= {kernel.full_name: kernel for kernel in found if kernel.declared}
    return kernels


@pytest.mark.parametrize("package", PACKAGES)
def test_libraries_have_the_code_of_the_sources(package):
    """If this fails, run scripts/kernels. Kernels under change may be listed meanwhile."""
    table = json.loads((ROOT / package / "kernels" / "table.json").read_text())
    of_sources = {
        name: {"digest": kernel.digest, "signatures": list(kernel.declared)}
        for name, kernel in declared(package).items()
        if name not in table["changing"]
    }
    assert of_sources == {
        name: row for name, row in table["kernels"].items() if name not in table["changing"]
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_libraries_are_those_of_their_table(package):
    folder = ROOT / package / "kernels"
    table = json.loads((folder / "table.json").read_text())
    there = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.so")}
    assert there == table["libraries"]


def run(source, folder, **environment):
    """Run a script beside a module ``kernels``, and return what it prints, and what it logs."""
    (folder / "script.py").write_text(source)
    command = [sys.executable, folder / "script.py"]
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        **environment,
    }
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)


WITHOUT_NUMBA = """
import sys
sys.modules["numba"] = None
"""
PLUGIN = """
import logging
import numpy as np
from omniscv.compiled import njit
from omniscv.depth.surfaces import nearest_pixel
logging.basicConfig(level=logging.INFO, format="%(message)s")

@njit("int64, out float64[::1]", nogil=True)
def fill(row, values):
    for i in range(len(values)):
        values[i] = 2 * nearest_pixel((3, 3), float(i), float(row))[1]

values = np.zeros(5)
fill(1, values)
print(values.tolist())
"""


@needs_numba
def test_a_kernel_of_a_plugin_is_compiled_by_numba_with_ours(tmp_path):
    done = run(PLUGIN, tmp_path)
    assert done.stdout == "[0.0, 2.0, 4.0, 4.0, 4.0]\n", done.stderr


def test_a_kernel_that_must_be_compiled_without_numba_names_the_extra(tmp_path):
    done = run(WITHOUT_NUMBA + PLUGIN, tmp_path)
    assert "expected numba, which compiles it here; pip install 'omniscv[compile]'" in done.stderr


def test_images_need_no_numba(tmp_path):
    arguments = ["render", "--source", "mock://four-wall", "--size", "32x16", "--out", str(tmp_path / "out")]
    done = run(f"{WITHOUT_NUMBA}\nfrom omniscv.cli import run\nassert run({arguments}) == 0\n", tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def changed(monkeypatch):
    """A kernel whose source is not that of its library."""
    from omniscv.cameras.camera_kernels import blank

    kernel = compiled.Kernel(blank.py_func, blank.declared, {"nogil": True})
    library = compiled.load_library("omniscv")
    if library is None:
        pytest.skip("no library is built for this machine")
    other = library._replace(digests={**library.digests, kernel.full_name: "of other source"})
    monkeypatch.setattr(compiled, "load_library", lambda package: other)
    return kernel


@needs_numba
def test_a_changed_kernel_is_compiled_by_numba_and_says_so(changed, caplog):
    vectors = np.ones((2, 3))
    with caplog.at_level(logging.INFO, "omniscv.compiled"):
        changed(vectors, np.array([True, False]))
    assert np.isnan(vectors).tolist() == [[False] * 3, [True] * 3]
    assert "camera_kernels.blank: numba compiles it, since" in caplog.text


@needs_numba
def test_a_signature_that_is_not_declared_is_compiled_by_numba_and_says_so(caplog):
    from omniscv.cameras.camera_kernels import blank

    vectors = np.ones((2, 3), np.float32)
    with caplog.at_level(logging.INFO, "omniscv.compiled"):
        blank(vectors, np.array([True, False]))
    assert np.isnan(vectors).tolist() == [[False] * 3, [True] * 3]
    assert "for types of arguments that it does not declare" in caplog.text


def test_a_prepared_kernel_reads_what_its_arrays_hold_at_each_call():
    from omniscv.planning.patches import _best_windows

    points = np.array([[1.0, 0, 0], [0, 1.0, 0]])
    worth = np.zeros(2)
    axes = np.stack([np.eye(3), np.eye(3)[[2, 0, 1]]])
    prices = np.ones((1, 1))
    ratios = np.zeros(2)
    arrays = (points, worth, axes, np.array([0.1]), prices, np.array([3]), ratios, np.zeros((2, 3), np.int64))
    find = _best_windows.prepare(*arrays)
    find(1)
    assert ratios.tolist() == [0.0, 0.0]
    worth[:] = 2.0
    find(1)
    assert ratios.tolist() == [0.0, 2.0]


def test_an_input_of_another_layout_is_copied():
    from omniscv.cameras.camera_kernels import blank

    keep = np.array([True, False, False, True])[::2]
    vectors = np.ones((2, 3))
    blank(vectors, keep)
    assert np.isnan(vectors[:, 0]).tolist() == [False, True]


def test_an_output_of_another_layout_is_refused():
    from omniscv.cameras.camera_kernels import blank

    with pytest.raises(ValueError, match="expected an array in C order to write to"):
        blank(np.ones((3, 2)).T, np.array([True, False]))


def test_an_output_that_cannot_be_written_to_is_refused():
    from omniscv.cameras.camera_kernels import blank

    vectors = np.ones((2, 3))
    vectors.flags.writeable = False
    with pytest.raises(ValueError, match="expected an array that can be written to"):
        blank(vectors, np.array([True, False]))


NO_SIGNATURES = ["float65", "float64[:", "float64[:] float64", "(int64", "int64 -> float64[:]", "Nothing"]


@pytest.mark.parametrize("text", NO_SIGNATURES)
def test_a_text_that_is_no_signature_is_refused(text):
    with pytest.raises(ValueError, match="signature"):
        signatures.parse(text, {})


def test_numba_is_imported_by_nothing_but_the_dispatcher():
    importing = set()
    for package in PACKAGES.values():
        for path in Path(package.__file__).parent.rglob("*.py"):
            if re.search(r"^\s*(import|from) numba\b", path.read_text(), re.MULTILINE):
                importing.add(str(path.relative_to(ROOT)))
    assert importing == {"mock_server/compiled.py"}


@pytest.fixture(scope="module")
def calls():
    return recorded_calls()


def test_every_signature_is_called(calls):
    called = {(kernel.full_name, index) for kernel, index, _ in calls}
    kernels = {**declared("omniscv"), **declared("mock_server")}
    due = {(name, index) for name, kernel in kernels.items() for index in range(len(kernel.declared))}
    assert called == due


HERE = [
    path.name
    for path in (ROOT / "omniscv" / "kernels").glob(re.sub("(-v[34])?.so", "*", compiled.library_name()))
]
"""The libraries that run on this machine."""


@needs_numba
@pytest.mark.soak
@pytest.mark.parametrize("library", HERE)
def test_libraries_and_numba_give_equal_bytes(calls, library):
    """numba compiles all for a minute."""
    loaded = {package: ctypes.CDLL(str(ROOT / package / "kernels" / library)) for package in PACKAGES}
    differing = []
    for kernel, index, args in calls:
        from_library = copy.deepcopy(args)
        by_numba = copy.deepcopy(args)
        words = []
        assert kernel.signatures[index].pack(from_library, words, [])
        function = loaded[kernel.__module__.partition(".")[0]][compiled.symbol(kernel.full_name, index)]
        result = compiled.Code(kernel.full_name, function, kernel.signatures[index]).run(words)
        expected = kernel.dispatcher(*by_numba)
        if content(from_library) != content(by_numba) or content(result) != content(expected):
            differing.append(f"{kernel.full_name} {index}")
    assert not differing


@pytest.mark.soak
def test_libraries_are_built_by_the_script_byte_by_byte():
    """It makes an environment with a linker, which takes a minute."""
    done = subprocess.run([ROOT / "scripts" / "kernels", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def content(value):
    """Return the bytes of numbers and arrays."""
    if isinstance(value, tuple):
        return [content(item) for item in value]
    return None if value is None else (np.asarray(value).dtype.kind, np.asarray(value).tobytes())
