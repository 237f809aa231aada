"""One episode as one row of ``episodes.parquet``: its conditions, the groups it counts in, every
metric; no arrays.
"""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.metrics import METRICS, measure
from dynahoi_lerobot.metrics.columns import COUNTS, STRATA, TEXTS, travel_u

Row = dict[str, Any]

METRIC_TYPE = "double"
"""Arrow's type of a metric's column, null where the metric does not apply. Types are explicit,
because a column may hold nothing but nulls."""

identity = itemgetter(
    "split", "seed", "kind", "object", "length_frames", "window_frames", "intercept"
)
"""What two rows have in common if they are runs of the same episode. A seed draws another path for
another observation window or from other objects, often with the same object and length."""


def measured(rows: Sequence[Row]) -> list[str]:
    """Return the names of the registered metrics that some of ``rows`` have, sorted.

    A metric that was registered after an evaluation is missing in its rows; one that was measured
    and does not apply is None.
    """
    held = {name for row in rows for name in row}
    return [name for name in METRICS.names() if name in held]


def episode_row(episode: Episode) -> Row:
    """Return one episode as a row: metadata, outcome, groups and metrics (None where one does not
    apply).
    """
    return {
        **{name: getattr(episode.meta, name) for name in (*TEXTS, *COUNTS)},
        "intercept": " ".join(str(round(1e4 * float(x))) for x in episode.intercept_pos_h),
        "travel_u": travel_u(episode),
        "grasp_rad": float(np.abs(episode.reference_joints - episode.open_joints).mean()),
        "first_localized": episode.first_localized,
        "stage": episode.stage,
        "success": bool(episode.success),
        **{name: stratum.label(episode) for name, stratum in STRATA.items()},
        **measure(episode),
    }
