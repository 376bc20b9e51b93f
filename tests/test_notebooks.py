"""Every notebook runs from top to bottom, and is stored without outputs."""

import os
from pathlib import Path

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError

from docs.machinery import notebooks

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def loaded(path):
    return nbformat.read(path, as_version=4)


def code_of(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs(path):
    notebook = loaded(path)
    nbformat.validate(notebook)
    for cell in code_of(notebook):
        assert cell.outputs == []
        assert cell.execution_count is None
    assert any("assert " in cell.source for cell in code_of(notebook))
    # The metadata contain nothing about the machine on which it was written.
    assert notebook.metadata.get("kernelspec", {}).get("name", "python3") == "python3"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, monkeypatch):
    """The notebook runs in its own kernel, in an empty folder, in its short form.

    GIAJAX_SHORT can select the long form. A notebook that `make docs` ran with the same source is
    not run again.
    """
    monkeypatch.setenv("GIAJAX_SHORT", os.environ.get("GIAJAX_SHORT", "1"))
    notebook = notebooks.executed(path)
    assert all(cell.execution_count for cell in code_of(notebook))
    outputs = [output for cell in code_of(notebook) for output in cell.outputs]
    shown = [output.data for output in outputs if "data" in output]
    if path.stem == "03_hysteresis":
        tables = [data.get("text/html", "") for data in shown]
        assert any("<table><thead><tr><th>parameter</th>" in html for html in tables)
    else:
        assert any("image/png" in data for data in shown)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_an_execution_is_kept_until_the_notebook_changes(tmp_path):
    path, kept = tmp_path / "small.ipynb", tmp_path / "kept"

    def write(source):
        cell = nbformat.v4.new_code_cell(source)
        nbformat.write(nbformat.v4.new_notebook(cells=[cell]), path)

    def printed():
        (cell,) = notebooks.executed(path, kept).cells
        return cell.outputs[0].text

    write("import time; print(time.time())")
    first = printed()
    assert printed() == first
    write("import time; print(time.time() + 1)")
    assert printed() != first
    assert len(list(kept.iterdir())) == 1
    write("1 / 0")
    with pytest.raises(CellExecutionError, match="ZeroDivisionError"):
        notebooks.executed(path, kept)
    assert len(list(kept.iterdir())) == 1
