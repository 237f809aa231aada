"""Notebooks run from a clean kernel in an empty folder; the one that trains is committed with its
outputs, others without.
"""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

PATHS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
TRAINS = "learn"
TINY = {
    "STEPS = 1_000_000": "STEPS = 1",
    "WORLDS = 64": "WORLDS = 4",
    "EPISODES = 1_000": "EPISODES = 8",
}
"""What replaces lines of that notebook."""
SHOWN = {"image/png", "image/gif"}
NOTEBOOK = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


@NOTEBOOK
def test_outputs_are_committed_where_they_take_minutes(path: Path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert cells
    if path.stem == TRAINS:
        assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
        assert shown(notebook) >= SHOWN
    else:
        assert not any(cell.outputs or cell.execution_count for cell in cells)


def shown(notebook: nbformat.NotebookNode) -> set[str]:
    """The kinds of data in a notebook's outputs."""
    return {
        kind
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        for kind in output.get("data", {})
    }


@pytest.mark.nightly
@pytest.mark.slow
@NOTEBOOK
def test_every_cell_runs(path: Path, tmp_path: Path):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        cell.source = "\n".join(TINY.get(line, line) for line in cell.source.split("\n"))
    NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert shown(notebook) >= SHOWN
