"""Progress of long work on standard error: a bar in a terminal, else a line every ten seconds."""

import io
import sys
from typing import Any

from tqdm import tqdm

LINE_S = 10
"""Time between two lines where standard error is no terminal, such as in a job's log."""


class _Lines(io.TextIOBase):
    """Prints each state of a bar on a line of its own, instead of over the last one."""

    def write(self, text: str) -> int:
        """Print text that is not blank."""
        line = text.strip()
        if line:
            print(line, file=sys.stderr, flush=True)
        return len(text)


def progress_bar(iterable: Any = None, **settings: Any) -> tqdm:
    """Return tqdm over ``iterable`` with its ``settings``, such as ``total`` and ``desc``."""
    if sys.stderr.isatty():
        return tqdm(iterable, **settings)
    slow = {"delay": LINE_S, "mininterval": LINE_S, "maxinterval": LINE_S, "miniters": 1}
    return tqdm(iterable, file=_Lines(), leave=False, ncols=100, ascii=True, **slow, **settings)
