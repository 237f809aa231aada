"""Files that are either whole or absent: write beside the goal, then rename."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def write_atomically(writers: dict[Path, Callable[[Path], object]]) -> None:
    """Write every file beside its goal, and rename only when all are complete.

    Args:
        writers: the goal of each file and the function that writes it to a given path. They are renamed in
            this order, so the last file is the sign that the others are there.
    """
    drafts = {goal: goal.with_name(f".{goal.name}.{os.getpid()}.part") for goal in writers}
    try:
        for goal, write in writers.items():
            goal.parent.mkdir(parents=True, exist_ok=True)
            write(drafts[goal])
        for goal, draft in drafts.items():
            draft.replace(goal)
    finally:
        for draft in drafts.values():
            draft.unlink(missing_ok=True)
