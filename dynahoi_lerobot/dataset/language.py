"""Subtasks of an episode in LeRobot's persistent language column.

LeRobot 0.6.1 (``lerobot.datasets.language``) repeats all rows of an episode in every frame; which of them is active at
a time it finds by their timestamps (``lerobot.datasets.language_render.active_at``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.conventions import CONTROL_HZ

LANGUAGE = "language_persistent"
"""LeRobot's name of the column."""
WATCH, REACH, HOLD = "watch the target", "reach and intercept the target", "close the hand and hold the target"

INFO = {"dtype": "language", "shape": [1], "names": None}
"""Its entry in ``info.json``."""
ARROW = pa.list_(
    pa.struct(
        [
            pa.field("role", pa.string()),
            pa.field("content", pa.string()),
            pa.field("style", pa.string()),
            pa.field("timestamp", pa.float32()),
            pa.field("camera", pa.string()),
            pa.field("tool_calls", pa.list_(pa.string())),
        ]
    )
)
_TEXT = {"dtype": "string", "_type": "Value"}
HUGGING_FACE = {
    "feature": {
        "role": _TEXT,
        "content": _TEXT,
        "style": _TEXT,
        "timestamp": {"dtype": "float32", "_type": "Value"},
        "camera": _TEXT,
        "tool_calls": {"feature": _TEXT, "_type": "List"},
    },
    "_type": "List",
}
"""The type that ``datasets`` reads from the note in the parquet files."""


def subtask_rows(acting: np.ndarray, localized: np.ndarray) -> list[dict[str, Any]]:
    """Return the subtasks of an episode in LeRobot's form, each with the time [s] from which it is active.

    The target is watched while commands are void, then it is to be reached, and held from the frame on which it is
    localised first.

    Args:
        acting: (T,) bool, commands take effect.
        localized: (T,) bool, the target is, or has been, localised.
    """
    state = np.where(localized, 2, acting)  # (T,)
    begins = np.flatnonzero(np.diff(state, prepend=-1))
    return [_row((WATCH, REACH, HOLD)[int(state[frame])], int(frame)) for frame in begins]


def language_column(rows: list[dict[str, Any]], frames: int) -> pa.Array:
    """Return the column: the same rows in each of an episode's frames."""
    return pa.array([rows] * frames, ARROW)


def _row(content: str, frame: int) -> dict[str, Any]:
    time = float(np.float32(frame / CONTROL_HZ))  # as in the column timestamp
    told = {"role": "assistant", "content": content, "style": "subtask", "timestamp": time}
    return told | {"camera": None, "tool_calls": None}
