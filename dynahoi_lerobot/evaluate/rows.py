"""One episode as one row of a table: what it was, where it belongs, every metric. No images, no arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dynahoi_lerobot.episode import Episode
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
    "length_frames": "int64",
    "window_frames": "int64",
    "intercept_frame": "int64",
    "attempts": "int64",
    "fingerprint": "string",
}
"""Columns copied from ``EpisodeMeta``."""

OUTCOME = {
    "travel_u": "double",
    "first_localized": "int64",
    "stage": "string",
    "success": "bool",
}
"""Columns read off the episode; ``first_localized`` is a frame or null, ``travel_u`` is in u."""

IDENTITY = ("split", "seed", "kind", "object", "length_frames")
"""Columns that tell whether two rows are runs of the same episode."""


def episode_row(episode: Episode) -> Row:
    """Return one episode's meta data, outcome, strata and metrics (None where one does not apply)."""
    return {
        **{name: getattr(episode.meta, name) for name in PLAIN},
        "travel_u": travel_u(episode),
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
