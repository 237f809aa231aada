"""Sphinx extension: the notebooks as pages, without their outputs, which are not committed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from docs.extensions.generated import write_pages

FOLDER = "notebooks"
NOTEBOOKS = Path(__file__).parents[1] / FOLDER


def pages() -> dict[str, str]:
    """Return the text of every page by its path below ``docs``."""
    return {f"{FOLDER}/{path.stem}.md": page_of(path) for path in sorted(NOTEBOOKS.glob("*.ipynb"))}


def page_of(notebook: Path) -> str:
    """Return a notebook as Markdown, with a link to the file below its title."""
    title, *cells = map(_shown, json.loads(notebook.read_text())["cells"])
    return "\n\n".join([title, f"{{download}}`The notebook <{notebook.name}>`, for Jupyter or Colab.", *cells]) + "\n"


def _shown(cell: dict[str, Any]) -> str:
    text = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return text
    language, body = ("bash", text.partition("\n")[2]) if text.startswith("%%bash") else ("ipython", text)
    return f"```{language}\n{body}\n```"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir), FOLDER, pages()))
    return {"parallel_read_safe": True}
