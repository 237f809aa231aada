"""The documentation site: `uv run sphinx-build -W --keep-going docs docs/_build`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import dynahoi_lerobot

project = "dynahoi-lerobot"
author = "the dynahoi-lerobot contributors"
copyright = f"{author}, Apache-2.0"
release = dynahoi_lerobot.__version__
html_title = f"{project} {release}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docs.extensions.api_pages",
    "docs.extensions.gallery",
    "docs.extensions.mathml",
    "docs.extensions.no_requests",
    "docs.extensions.notebook_pages",
    "docs.extensions.repository_files",
]
exclude_patterns = ["_build", "scripts", "extensions"]
html_math_renderer = "mathml"
html_theme = "furo"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]

myst_enable_extensions = ["attrs_block", "attrs_inline", "dollarmath"]
myst_heading_anchors = 4

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_default_options = {"members": True, "show-inheritance": True, "ignore-module-all": True}
napoleon_use_ivar = True
napoleon_custom_sections = [("Class attributes", "params_style")]
