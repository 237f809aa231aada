"""The notebooks run from a clean kernel in an empty folder, and are committed without outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from docs.extensions.notebook_pages import NOTEBOOKS, page_of

PATHS = sorted(NOTEBOOKS.glob("*.ipynb"))
NOTEBOOK = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


def test_there_are_two():
    assert [path.stem for path in PATHS] == ["data", "train"]


@NOTEBOOK
def test_outputs_are_not_committed_and_the_first_cell_installs_on_colab(path: Path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)
    assert "google.colab" in cells[0].source
    assert "%pip install" in cells[0].source


@NOTEBOOK
def test_the_page_shows_every_cell(path: Path):
    text = page_of(path)
    notebook = nbformat.read(path, as_version=4)
    assert all(cell.source.removeprefix("%%bash\n").rstrip() in text for cell in notebook.cells)


@pytest.mark.slow
@NOTEBOOK
def test_every_cell_runs(path: Path, tmp_path: Path):
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = {kind for cell in notebook.cells for output in cell.get("outputs", []) for kind in output.get("data", {})}
    assert {"image/png", "image/gif"} <= shown
