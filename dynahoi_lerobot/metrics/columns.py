"""What results hold of every episode beside its metrics: its conditions, its outcome and the
groups it counts in.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import UNIT_M
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.motions.base import CATEGORIES

# -- groups ----------------------------------------------------------------------------------------

PERIODICITIES = ("circular", "periodic", "linear", "hybrid")
"""From the clearest periodic signature to none (Appendix "Stratified Performance Analysis").

The paper names straight lines and projectiles as linear, harmonic motion and pendulums as periodic;
rolling and impacts revisit nothing, hence linear. A hybrid changes between these within one
episode, so it keeps its own label.
"""

ELSEWHERE = ("other", "other")
"""Tier and periodicity of a category outside the paper's eight."""

DURATIONS = ("<20", "20-40", "40-60", "60-80", "80-120", ">120")
DURATION_EDGES = (20, 40, 60, 80, 120)
"""Duration bins and their upper edges [frames] (Figure "Data statistics", c), each part of the
lower bin."""

TRAVELS = ("0-0.5", "0.5-2", "2-4", ">4")
TRAVEL_EDGES = (0.5, 2.0, 4.0)
"""Travel bins and their upper edges [u] (Figure "Data statistics", d), each part of the lower
bin."""


def travel_u(episode: Episode) -> float:
    """Return the straight distance [u = 0.1 m] from the palm at control start to the intercept
    point.
    """
    start = episode.palm_pos_h[min(episode.meta.window_frames, len(episode) - 1)]
    return float(np.linalg.norm(episode.intercept_pos_h.astype(np.float64) - start)) / UNIT_M


def _duration(episode: Episode) -> str:
    """The bin of the recording's length L [frames]; 20 frames count as 20-40."""
    frames = episode.meta.length_frames
    return DURATIONS[1 if frames == DURATION_EDGES[0] else bisect_left(DURATION_EDGES, frames)]


@dataclass(frozen=True)
class Stratum:
    """One way to group episodes into disjoint labels.

    Attributes:
        label: the group of an episode.
        order: the labels in the order in which figures show them; empty means alphabetical.
    """

    label: Callable[[Episode], str]
    order: tuple[str, ...] = ()

    def arrange(self, labels: set[str]) -> list[str]:
        """Return ``labels`` sorted in the stratum's order, unknown ones last."""
        rank = {label: place for place, label in enumerate(self.order)}
        return sorted(labels, key=lambda label: (rank.get(label, len(rank)), label))


STRATA = {
    "tier": Stratum(
        lambda episode: CATEGORIES.get(episode.meta.category, ELSEWHERE)[0],
        tuple(dict.fromkeys(tier for tier, _ in CATEGORIES.values())),
    ),
    "category": Stratum(lambda episode: episode.meta.category, tuple(CATEGORIES)),
    "kind": Stratum(lambda episode: episode.meta.motion),
    "object": Stratum(lambda episode: episode.meta.object),
    "periodicity": Stratum(
        lambda episode: CATEGORIES.get(episode.meta.category, ELSEWHERE)[1], PERIODICITIES
    ),
    "duration": Stratum(_duration, DURATIONS),
    "travel": Stratum(
        lambda episode: TRAVELS[bisect_left(TRAVEL_EDGES, travel_u(episode))], TRAVELS
    ),
}
"""The groups by which results are broken down; each is a column of its name."""

# -- columns ---------------------------------------------------------------------------------------

TEXTS = ("split", "agent", "capture", "protocol", "control_class", "code", "benchmark")
COUNTS = ("seed", "length_frames", "window_frames", "intercept_frame", "attempts")
"""Columns copied from ``EpisodeMeta``."""

COLUMNS = (
    dict.fromkeys(TEXTS, "string")
    | dict.fromkeys(COUNTS, "int64")
    | {
        "intercept": "string",
        "travel_u": "double",
        "grasp_rad": "double",
        "first_localized": "int64",
        "stage": "string",
        "success": "bool",
    }
    | dict.fromkeys(STRATA, "string")
)
"""Arrow's type of every column, whose name no metric may have. ``intercept`` is where the expert
may meet the target, relative to the palm's start, "x y z" in 0.1 mm; ``travel_u`` is in u (0.1 m),
``grasp_rad`` the mean rotation of a joint from the open hand to the reference grasp,
``first_localized`` a frame."""

COMMANDS = "commands"
"""Compared beside the metrics, so none has its name: how far apart two evaluations command the
palm."""
