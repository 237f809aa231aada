"""Sphinx extension: a page with a moving picture for everything that is registered, drawn before the build."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

from docs.extensions.gallery import pages as gallery
from docs.extensions.gallery.pictures import draw_missing
from docs.extensions.generated import write_pages


def _generate(app: Sphinx) -> None:
    draw_missing(Path(app.srcdir) / gallery.FOLDER)
    write_pages(Path(app.srcdir), gallery.FOLDER, gallery.pages())


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw the pictures that are missing and write the pages when a build begins.

    After that the process owns MuJoCo's threads, without which a forked reader waits forever.
    """
    app.connect("builder-inited", _generate)
    return {"parallel_read_safe": False}
