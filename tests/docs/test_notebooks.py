"""The notebook that trains runs from a clean kernel in an empty folder, and is committed with its
outputs; the documentation's build runs the others, which are committed without.
"""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
TRAINS = FOLDER / "learn.ipynb"
TINY = {
    "STEPS = 1_000_000": "STEPS = 2_000",  # some episodes end
    "WORLDS = 64": "WORLDS = 4",
    "EPISODES = 1_000": "EPISODES = 8",
}
"""What replaces lines of that notebook."""
SHOWN = {"image/png", "image/gif"}


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_outputs_are_committed_where_they_take_minutes(path: Path):
    notebook = nbformat.read(path, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    if path == TRAINS:
        assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
        assert shown(notebook) >= SHOWN
    else:
        assert not any(cell.outputs for cell in cells)


def shown(notebook: nbformat.NotebookNode) -> set[str]:
    """The kinds of data in a notebook's outputs."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return {kind for output in outputs for kind in output.get("data", {})}


@pytest.mark.nightly
@pytest.mark.slow
def test_the_notebook_that_trains_runs(tmp_path: Path):
    notebook = nbformat.read(TRAINS, as_version=4)
    for cell in notebook.cells:
        cell.source = "\n".join(TINY.get(line, line) for line in cell.source.split("\n"))
    NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert shown(notebook) >= SHOWN
