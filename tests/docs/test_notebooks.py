"""Notebooks run from a clean kernel in an empty folder, and are committed without outputs."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

PATHS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
TINY = {"STEPS = 1_000_000": "STEPS = 1", "WORLDS = 64": "WORLDS = 4"}
"""What replaces lines of the notebooks that train."""
NOTEBOOK = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


@NOTEBOOK
def test_outputs_are_not_committed(path: Path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)
    assert cells


@pytest.mark.nightly
@pytest.mark.slow
@NOTEBOOK
def test_every_cell_runs(path: Path, tmp_path: Path):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        cell.source = "\n".join(TINY.get(line, line) for line in cell.source.split("\n"))
    NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = {
        kind
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        for kind in output.get("data", {})
    }
    assert {"image/png", "image/gif"} <= shown
