"""Strata, by which results are broken down: tier, category, motion, object, periodicity, duration and travel."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynahoi_lerobot.core.conventions import UNIT_M
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.motions.base import CATEGORIES

Label = Callable[[Episode], str]

PERIODICITIES = ("circular", "periodic", "linear", "hybrid")
"""From the clearest periodic signature to none (Appendix "Stratified Performance Analysis").

The paper names straight lines and projectiles as linear, harmonic motion and pendulums as periodic; rolling
and impacts revisit nothing, hence linear. A hybrid changes between these within one episode, so it keeps its
own label.
"""

ELSEWHERE = ("other", "other")
"""Tier and periodicity of a category outside the paper's eight."""

DURATION_EDGES = (20, 40, 60, 80, 120)
"""Upper edges [frames] of the duration bins (Figure "Data statistics", c), each part of the lower bin."""

TRAVEL_EDGES = (0.5, 2.0, 4.0)
"""Upper edges [u] of the travel bins (Figure "Data statistics", d), each part of the lower bin."""


@dataclass(frozen=True)
class Stratum:
    """One way to group episodes into disjoint labels.

    Attributes:
        name: the column that holds the label.
        label: the group of an episode.
        order: the labels in the order in which figures show them; empty means alphabetical.
    """

    name: str
    label: Label
    order: tuple[str, ...] = ()

    def arrange(self, labels: set[str]) -> list[str]:
        """Return ``labels`` sorted in the stratum's order, unknown ones last."""
        rank = {label: place for place, label in enumerate(self.order)}
        return sorted(labels, key=lambda label: (rank.get(label, len(rank)), label))


STRATA: dict[str, Stratum] = {}


def stratum(name: str, order: tuple[str, ...] = ()) -> Callable[[Label], Label]:
    """Return a decorator that registers a labelling function as the stratum ``name``."""

    def decorate(label: Label) -> Label:
        STRATA[name] = Stratum(name, label, order)
        return label

    return decorate


def travel_u(episode: Episode) -> float:
    """Return the straight distance [u = 0.1 m] from the palm at control start to the intercept point."""
    start = episode.palm_pos_h[min(episode.meta.window_frames, len(episode) - 1)]
    return float(np.linalg.norm(episode.intercept_position.astype(np.float64) - start)) / UNIT_M


@stratum("tier", tuple(dict.fromkeys(tier for tier, _ in CATEGORIES.values())))
def tier(episode: Episode) -> str:
    """Return the tier of the episode's category, ``other`` for a category outside the paper's eight."""
    return CATEGORIES.get(episode.meta.category, ELSEWHERE)[0]


@stratum("category", tuple(CATEGORIES))
def category(episode: Episode) -> str:
    """Return the episode's category, one of the paper's eight."""
    return episode.meta.category


@stratum("kind")
def kind(episode: Episode) -> str:
    """Return the name of the episode's motion."""
    return episode.meta.motion


@stratum("object")
def object_name(episode: Episode) -> str:
    """Return the name of the episode's object."""
    return episode.meta.object


@stratum("periodicity", PERIODICITIES)
def periodicity(episode: Episode) -> str:
    """Return ``circular``, ``periodic``, ``linear`` or ``hybrid``."""
    return CATEGORIES.get(episode.meta.category, ELSEWHERE)[1]


def _bin_names(edges: tuple[float, ...], lowest: str) -> tuple[str, ...]:
    inner = (f"{low:g}-{high:g}" for low, high in pairwise(edges))
    return (lowest, *inner, f">{edges[-1]:g}")


DURATIONS = _bin_names(DURATION_EDGES, "<20")
TRAVELS = _bin_names(TRAVEL_EDGES, "0-0.5")


@stratum("duration", DURATIONS)
def duration(episode: Episode) -> str:
    """Return the bin of the recording's length L [frames]; 20 frames count as 20-40."""
    frames = episode.meta.length_frames
    return DURATIONS[1 if frames == DURATION_EDGES[0] else bisect_left(DURATION_EDGES, frames)]


@stratum("travel", TRAVELS)
def travel(episode: Episode) -> str:
    """Return the bin of the straight distance from palm to intercept point [u]."""
    return TRAVELS[bisect_left(TRAVEL_EDGES, travel_u(episode))]
