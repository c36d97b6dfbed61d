"""The tutorial for notebooks runs, and shows what it shows in the repository."""

import pytest
from support.command_line import ROOT

PATH = ROOT / "docs/tutorials/notebook.ipynb"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the client's own libraries
def test_the_notebook_runs(tmp_path, monkeypatch):
    import nbformat  # here: each worker of pytest imports all test files
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    written = nbformat.read(PATH, as_version=4)
    notebook = nbformat.read(PATH, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    NotebookClient(notebook, timeout=180, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert kinds(notebook) == kinds(written)
    assert sum("image/png" in each for each in kinds(notebook)) == 5


def kinds(notebook):
    """What each cell shows, by its media types."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [sorted(output.get("data", {output.output_type: 0})) for output in outputs]
