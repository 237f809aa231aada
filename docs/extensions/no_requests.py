"""Sphinx extension: no page of the site may make a browser ask another host for anything."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

logger = getLogger(__name__)
LOADING = {"src", "srcset", "poster", "data"}
"""Attributes whose value a browser loads by itself."""
LINKED = {"stylesheet", "icon", "preload", "prefetch", "preconnect", "dns-prefetch", "modulepreload", "manifest"}
"""Kinds of <link> that a browser follows by itself."""
ELSEWHERE = re.compile(r"^\s*(?:\w+:)?//")
IN_STYLE = re.compile(r"(?:url\(|@import)\s*['\"]?((?:\w+:)?//[^'\")\s]+)")


class _Requests(HTMLParser):
    """Collects what a page would load from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.in_style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        loaded = [value for name, value in values.items() if name in LOADING]
        if tag == "link" and LINKED & set(values.get("rel", "").split()):
            loaded.append(values.get("href", ""))
        self.found += [value for value in loaded if ELSEWHERE.match(value)]
        self.found += IN_STYLE.findall(values.get("style", ""))
        self.in_style = tag == "style"

    def handle_data(self, data: str) -> None:
        if self.in_style:
            self.found += IN_STYLE.findall(data)

    def handle_endtag(self, tag: str) -> None:
        self.in_style = False


def requests_of(text: str, suffix: str = ".html") -> list[str]:
    """Return the addresses on other hosts that a browser loads for a page, or for a style sheet (``.css``)."""
    if suffix == ".css":
        return IN_STYLE.findall(text)
    parser = _Requests()
    parser.feed(text)
    return parser.found


def _check(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        for path in sorted(Path(app.outdir).rglob("*")):
            for address in requests_of(path.read_text(), path.suffix) if path.suffix in (".html", ".css") else ():
                logger.warning("%s would load %s", path.relative_to(app.outdir), address)


def setup(app: Sphinx) -> dict[str, bool]:
    """Look at every page when a build has finished."""
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True}
