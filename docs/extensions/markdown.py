"""Links and code blocks of Markdown, for the site and for the tests of the pages."""

from __future__ import annotations

import re
from collections.abc import Callable

FENCE = re.compile(r"^```(\w*|\{[\w-]+\}.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A block of code, or a directive of MyST: language, or name and argument, and body."""

LINK = re.compile(r"\[([^\[\]]*)\]\(([^()\s]+)\)")
"""A link or a picture: text and target."""


def is_local(target: str) -> bool:
    """Tell whether a link leads to a file of the project, and not to an address or a heading of the same page."""
    return "://" not in target and not target.startswith(("#", "mailto:"))


def map_links(text: str, change: Callable[[str], str]) -> str:
    """Return ``text`` with the target of every local link outside of code blocks replaced by what ``change`` makes."""
    parts, end = [], 0
    for fence in FENCE.finditer(text):
        parts += [_mapped(text[end : fence.start()], change), fence.group()]
        end = fence.end()
    return "".join([*parts, _mapped(text[end:], change)])


def _mapped(prose: str, change: Callable[[str], str]) -> str:
    def swap(match: re.Match[str]) -> str:
        target = match.group(2)
        return f"[{match.group(1)}]({change(target) if is_local(target) else target})"

    return LINK.sub(swap, prose)
