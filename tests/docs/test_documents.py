"""What README.md and the pages of docs/ tell readers to run, runs."""

import multiprocessing
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest
from support.command_line import READING, ROOT, name_of, run, shape_of
from support.documents import LEAST_PX, at_ports, blocks, shrunk, unfenced

from omniscv.planning import densities

DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BY_NAME = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in DOCUMENTS}


def commands(name):
    lines = [words for block in blocks(BY_NAME[name]) for words in block.commands()]
    return [words for words in lines if words[0] == "omniscv"]


FIRST = {}
"""By the shape of a command line that leaves nothing behind, the document that runs it."""
for _name in BY_NAME:
    for _words in commands(_name):
        if name_of(_words) in READING:
            FIRST.setdefault(shape_of(_words), _name)


def test_commands_are_where_they_are_run():
    """Fence them as ``sh``, and what cannot run as ``text``."""
    assert {"README.md", "docs/scenes.md", "docs/tutorials/offline.md"} <= set(BY_NAME)
    assert {name: found for name, text in BY_NAME.items() if (found := unfenced(text))} == {}


@pytest.fixture(scope="module")
def processes():
    """Forks of one process that has loaded what documents use."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["test_documents", "support.warm"])
    with pytest.MonkeyPatch.context() as patch:  # Python 3.11 does not give it the path to import these from
        patch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        with context.Pool(1) as pool:  # starts it
            assert pool.apply(loaded), "support.warm was not loaded"
    return context


def loaded():
    return "support.warm" in sys.modules


RUN = [
    name
    for name, text in BY_NAME.items()
    if any(block.language == "python" or block.commands() for block in blocks(text))
    and (name != "docs/torch.md" or find_spec("torch"))
]


@pytest.mark.parametrize("name", RUN)
def test_a_document_runs(name, folder, ports, processes):
    """In a process of its own, because what a document registers stays registered."""
    with processes.Pool(1) as pool:
        pool.apply(execute, (blocks(BY_NAME[name]), name, folder, ports))


def execute(document, name, folder, ports):
    """Run a document with faces that are small wherever the planner chooses their size."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(densities, "SMALLEST", LEAST_PX)
        run_blocks(document, name, folder, ports)


def run_blocks(document, name, folder, ports):
    """Write the files of a document, run its Python in one namespace, and its commands."""
    tests = any("def test_" in block.text for block in document if block.language == "python")
    namespace = {"__name__": "__main__"}
    ran = set()
    for block in document:
        if block.file_name():
            (folder / block.file_name()).write_text(shrunk(block.text), encoding="utf-8")
        elif block.language == "python" and not tests:
            text = "\n" * (block.line - 1) + at_ports(shrunk(block.text), ports)
            exec(compile(text, name, "exec"), namespace)
        for words in block.commands():
            shape = shape_of(words) if words[0] == "omniscv" else None
            run(words, ports, parsed_only=FIRST.get(shape, name) != name or shape in ran & FIRST.keys())
            ran.add(shape)
    if tests:
        run_tests([block.text for block in document if block.language == "python"], folder)


def run_tests(texts, folder):
    """Run the Python of a document about tests by pytest, with recordings made anew."""
    path = folder / "test_document.py"
    path.write_text(shrunk("\n\n".join(texts)), encoding="utf-8")
    (folder / "pytest.ini").touch()
    options = ["-q", "--record-mode=once", "-p", "no:cacheprovider", "-p", "no:hypothesispytest"]
    command = [sys.executable, "-m", "pytest", *options, path.name]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
