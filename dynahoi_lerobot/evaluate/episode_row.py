"""One episode as one row of ``episodes.parquet``: what was played, its strata, every metric. No images, no arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.evaluate.strata import STRATA, travel_u
from dynahoi_lerobot.metrics import METRICS, measure

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]

PLAIN = {
    "seed": "int64",
    "split": "string",
    "agent": "string",
    "capture": "string",
    "protocol": "string",
    "control_class": "string",
    "length_frames": "int64",
    "window_frames": "int64",
    "intercept_frame": "int64",
    "attempts": "int64",
    "fingerprint": "string",
    "benchmark": "string",
}
"""Columns copied from ``EpisodeMeta``."""

OUTCOME = {
    "travel_u": "double",
    "grasp_rad": "double",
    "first_localized": "int64",
    "stage": "string",
    "success": "bool",
}
"""Columns read off the episode: ``travel_u`` in u (0.1 m), ``grasp_rad`` the mean rotation of a joint from the open
hand to the reference grasp, ``first_localized`` a frame or null."""

NULLABLE = {"first_localized", *METRICS.names()}
"""Columns that may hold nulls: the frame of an event that never happened, a metric whose condition does not hold."""

IDENTITY = ("split", "seed", "kind", "object", "length_frames")
"""Columns that tell whether two rows are runs of the same episode."""


def episode_row(episode: Episode) -> Row:
    """Return one episode as a row: metadata, outcome, strata and metrics (None where one does not apply)."""
    return {
        **{name: getattr(episode.meta, name) for name in PLAIN},
        "travel_u": travel_u(episode),
        "grasp_rad": float(np.abs(episode.reference_joints - episode.open_joints).mean()),
        "first_localized": episode.first_localized,
        "stage": episode.stage,
        "success": bool(episode.success),
        **{name: stratum.label(episode) for name, stratum in STRATA.items()},
        **measure(episode),
    }


def row_schema() -> pa.Schema:
    """Return the columns of ``episodes.parquet``; explicit, because a column may hold nothing but nulls."""
    import pyarrow as pa

    strata = dict.fromkeys(STRATA, "string")
    metrics = dict.fromkeys(METRICS.names(), "double")
    return pa.schema(list({**PLAIN, **OUTCOME, **strata, **metrics}.items()))


def checked_rows(table: pa.Table) -> list[Row]:
    """Return the rows of a table of ``row_schema`` that was read from a file.

    Raises:
        ValueError: if a value is missing, not finite, or outside the bounds of its metric.
    """
    rows = table.to_pylist()
    for row in rows:
        _check_row(row)
    return rows


def _check_row(row: Row) -> None:
    if missing := [name for name in (*PLAIN, *OUTCOME, *STRATA) if row[name] is None and name not in NULLABLE]:
        raise ValueError(f"seed {row['seed']} has no {missing[0]}")
    for name in ("travel_u", "grasp_rad"):
        if not math.isfinite(row[name]):
            raise ValueError(f"seed {row['seed']} has the {name} {row[name]}")
    for name, metric in METRICS.items():
        value, (low, high) = row.get(name), metric.bounds
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            raise ValueError(f"seed {row['seed']} has the {name} {value}, which must be {low:g} to {high:g}")
        if metric.aggregation == "rate" and value not in (None, 0.0, 1.0):
            raise ValueError(f"seed {row['seed']} has the {name} {value}, which must be 0 or 1")
