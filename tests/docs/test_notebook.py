"""The tutorial for notebooks runs, and shows what it shows in the repository."""

import json
import sys

from support.command_line import ROOT


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
