"""Examples and the notebook run as told; pages of commands and of borders are those of the code."""

import json
import re
import runpy
import shutil
import sys

import pytest
import yaml
from support.command_line import ROOT
from support.documents import blocks
from test_documents import BY_NAME, RUN, commands

from omniscv import dataset
from omniscv.cli.images import RECORD
from omniscv.job import keys, load
from omniscv.make import check_dataset, make

OTHERS = ("classes.yaml", "camchain.yaml")
JOBS = sorted(path for path in (ROOT / "examples").rglob("*.yaml") if path.name not in OTHERS)
UNUSED = set()
"""Keys that nobody has a reason to use, and that stay: at most ten."""


def dotted(value, start=""):
    """The keys of a job's file, with dots between levels."""
    for key, below in value.items() if isinstance(value, dict) else ():
        yield f"{start}{key}"
        yield from dotted(below, f"{start}{key}.")


def used_keys():
    """The keys of examples, of jobs that pages tell readers to run, and of options of such commands."""
    texts = [path.read_text(encoding="utf-8") for path in JOBS]
    for name in RUN:
        lines = [" ".join(words) for words in commands(name)]
        jobs = [block for block in blocks(BY_NAME[name]) if block.language == "yaml" and block.file_name()]
        texts += [job.text for job in jobs if any(job.file_name() in line for line in lines)]
        for line in lines:
            yield from re.findall(r"--set[ =]([\w.]+)=", line)
            if "--fix-exposure" in line:
                yield from RECORD["fix_exposure"].keys(True)
    for text in texts:
        job = yaml.safe_load(text)
        for of_world in [job, *(job.get("worlds") or {}).values()]:
            yield from dotted(of_world)


def test_every_key_of_a_job_is_used():
    assert {key.name for key in keys()} - set(used_keys()) == UNUSED


@pytest.mark.parametrize("path", JOBS, ids=lambda path: path.stem)
def test_the_jobs_of_examples_are_whole(path):
    check_dataset(load(path))


def test_pages_are_as_made_and_the_moving_world_is_the_one_that_its_document_runs():
    """Those of cameras by ``scripts/draw-cameras pages``, of docstrings and of what files hold."""
    made = runpy.run_path(str(ROOT / "scripts/draw-cameras"))["pages"]()
    pages = {f"docs/cameras/{name}.md": text for name, text in made.items()}
    pages["docs/conformance.md"] = runpy.run_path(str(ROOT / "scripts/conformance"))["page"]()
    for name, text in pages.items():
        assert (ROOT / name).read_text(encoding="utf-8") == text
    document = (ROOT / "docs" / "moving-worlds.md").read_text(encoding="utf-8")
    text = (ROOT / "examples" / "moving" / "moving.py").read_text(encoding="utf-8")
    _, script = text.split("\n\n", maxsplit=1)
    assert script in document


def test_the_dataset_is_made_and_explored(tmp_path, monkeypatch, capsys):
    folder = shutil.copytree(ROOT / "examples" / "kitchen", tmp_path / "kitchen")
    text = (folder / "kitchen.yaml").read_text()
    smaller = re.sub(r"((?:width|height|face_size|fx|fy): )(\d+)", lambda m: f"{m[1]}{int(m[2]) // 16}", text)
    (folder / "kitchen.yaml").write_text(smaller.replace("count: 4", "count: 1"))
    make(load(folder / "kitchen.yaml"))
    assert dataset.check(folder / "out", deep=True) == []
    monkeypatch.setattr(sys, "argv", ["explore.py", str(folder / "out")])
    runpy.run_path(str(folder / "explore.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.startswith("3 frames; splits {")
    assert "floor corners at" in printed


@pytest.mark.parametrize("folder", sorted((ROOT / "examples").iterdir()), ids=lambda path: path.name)
def test_an_example_has_a_page_with_a_command(folder):
    page = (folder / "README.md").read_text(encoding="utf-8")
    assert len(page.splitlines()) <= 20
    assert re.search(r"```(sh|text)\n\S", page)
    assert all((folder / path).exists() for path in re.findall(r"\]\(([^)#]+)", page))


def test_borders_are_modules_and_their_numbers_those_of_the_code():
    from mock_server import yaml_text
    from omniscv import arguments, errors
    from omniscv.dataset import manifest
    from omniscv.sources.unreal import client
    from omniscv.storage import base, bounded, remote

    page = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")][1:]
    for row in rows:
        for name in re.findall(r"`([\w/.]+)`", row[1]):
            assert (ROOT / "omniscv" / name).exists() or (ROOT / name).exists(), name
    checked = {row[0].strip("| "): row[2] for row in rows}

    def says(row, *bounds):
        assert all(str(bound) in checked[row] for bound in bounds), checked[row]

    assert (yaml_text.MOST_BYTES, base.MOST_BYTES) == (1 << 20, 1 << 30)
    says("jobs, scenes, calibration files", "1 MiB", f"{yaml_text.MOST_VALUES:,} values")
    says("jobs, scenes, calibration files", f"{yaml_text.MOST_LEVELS} levels", yaml_text.LONGEST_NUMBER)
    assert (bounded.MOST_JSON_BYTES, manifest._MOST_FRAMES_BYTES) == (64 << 20, 1 << 30)
    says("the manifest of a dataset", "64 MiB", "1 GiB", f"{arguments._LONGEST_STEM} bytes")
    seconds = remote._ANSWER_S, remote._PATIENCE_S, remote._LISTING_S
    says("an object store", *(f"{each:.0f} s" for each in seconds), f"{remote._SLOWEST / 1e3:.0f} kB")
    says("an UnrealCV server", f"{client.TIMEOUT_S:.0f} s for each", f"{client.PATIENCE_S:.0f} s for retries")
    says("what is printed", f"{errors.LONGEST_LINE} printable")


def test_the_notebook_runs(tmp_path, monkeypatch, request):
    from IPython.core.interactiveshell import InteractiveShell  # here: each worker imports all test files
    from IPython.core.pylabtools import select_figure_formats
    from IPython.display import display
    from IPython.utils.capture import capture_output
    from matplotlib import pyplot
    from traitlets.config import Config

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])  # which the shell replaces
    notebook = json.loads((ROOT / "docs/tutorials/notebook.ipynb").read_text(encoding="utf-8"))
    shell = InteractiveShell.instance(config=Config({"HistoryManager": {"hist_file": ":memory:"}}))
    request.addfinalizer(InteractiveShell.clear_instance)  # else images of later tests are shown in it
    pictures = 0
    select_figure_formats(shell, {"png"})
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            with capture_output() as shown:
                done = shell.run_cell("".join(cell["source"]), store_history=True)
                done.raise_error()
                for number in pyplot.get_fignums():  # as notebooks do
                    display(pyplot.figure(number))
                pyplot.close("all")
            kinds = [set(output.data) for output in shown.outputs]
            if done.result is not None:
                kinds.append(set(shell.display_formatter.format(done.result)[0]))
            assert kinds == [set(output["data"]) for output in cell["outputs"]]
            pictures += sum("image/png" in each for each in kinds)
    assert pictures == 5
