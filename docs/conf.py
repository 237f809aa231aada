"""The documentation: ``uv run --group docs sphinx-build docs docs/_build``; ``-b linkcheck`` checks
the links.
"""

import os
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from sphinx.util.rst import escape

import dynahoi_lerobot

project = "dynahoi-lerobot"
author = "the dynahoi-lerobot authors"
copyright = f"{author}, Apache-2.0"
release = dynahoi_lerobot.__version__
html_title = f"{project} {release}"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "jupyter_execute"]
default_role = "code"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "auto"
nb_execution_excludepatterns = ["notebooks/learn.ipynb"]  # its outputs are committed
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"


DOCS = Path(__file__).parent
OUTSIDE = {
    "readme": "README.md",
    "contributing": "CONTRIBUTING.md",
    "changelog": "CHANGELOG.md",
    "obact": "policies/lerobot_policy_obact/README.md",
    "actiontokens": "policies/lerobot_policy_actiontokens/README.md",
}
"""Pages of the site whose text is a file elsewhere in the repository, relative to its root."""
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\]\([^()]*\))*)\]\(([^()\s]+)\)")
"""A link or an image in Markdown: mark of an image, text, target."""


def setup(app: Any) -> None:
    """Connect the functions below to Sphinx.

    ``-D repository_url=URL`` names the repository's browsable root, such as
    ``https://HOST/USER/NAME/tree/main``. Links to folders lead there; without it they are text.
    """
    app.add_config_value("repository_url", "", "env")
    app.connect("source-read", _keep_links)
    # before napoleon reads the docstring
    app.connect("autodoc-process-docstring", _document_options, priority=400)


def _keep_links(app: Any, page: str, source: list[str]) -> None:
    """Make links that leave docs/ lead to a page, a file to download, or the repository."""
    text, folder = source[0], (DOCS / page).parent
    if page in OUTSIDE:
        file = DOCS.parent / OUTSIDE[page]
        text, folder = file.read_text(), file.parent
        app.env.note_dependency(file)
    pages = {DOCS.parent / file: DOCS / f"{name}.md" for name, file in OUTSIDE.items()}

    def moved(match: re.Match[str]) -> str:
        mark, label, target = match.groups()
        label = LINK.sub(moved, label)
        name, _, anchor = target.partition("#")
        if ":" in name or not name:
            return f"{mark}[{label}]({target})"
        path = (folder / name).resolve()
        if path.is_dir():
            url = app.config.repository_url
            return f"[{label}]({url}/{path.relative_to(DOCS.parent)})" if url else label
        place = os.path.relpath(pages.get(path, path), (DOCS / page).parent)
        return f"{mark}[{label}]({place}{'#' if anchor else ''}{anchor})"

    source[0] = LINK.sub(moved, text)


def _document_options(_app: Any, what: str, _name: str, item: Any, *others: Any) -> None:
    lines, entries = others[-1], fields(item) if what == "class" and is_dataclass(item) else ()
    if told := [
        f"    {entry.name}: {escape(entry.metadata['help'])}."
        for entry in entries
        if "help" in entry.metadata
    ]:
        lines += ["Attributes:", *told, ""]
