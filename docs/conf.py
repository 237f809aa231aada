"""The documentation: ``uv run --group docs sphinx-build docs docs/_build``; ``-b linkcheck`` checks
the links.
"""

from dataclasses import fields, is_dataclass
from typing import Any

from sphinx.util.rst import escape

import dynahoi_lerobot

project = "dynahoi-lerobot"
author = "the dynahoi-lerobot authors"
copyright = f"{author}, Apache-2.0"
release = dynahoi_lerobot.__version__
html_title = f"{project} {release}"
html_theme = "furo"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "jupyter_execute"]
suppress_warnings = [
    "myst.xref_missing"
]  # files outside of docs/; tests/docs/test_pages.py checks those links
default_role = "code"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "auto"
nb_execution_excludepatterns = ["notebooks/learn.ipynb"]  # ten minutes of training
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"


def setup(app: Any) -> None:
    """Document the options of a dataclass before napoleon reads its docstring."""
    app.connect("autodoc-process-docstring", _document_options, priority=400)


def _document_options(_app: Any, what: str, _name: str, item: Any, *others: Any) -> None:
    lines, entries = others[-1], fields(item) if what == "class" and is_dataclass(item) else ()
    if told := [
        f"    {entry.name}: {escape(entry.metadata['help'])}."
        for entry in entries
        if "help" in entry.metadata
    ]:
        lines += ["Attributes:", *told, ""]
