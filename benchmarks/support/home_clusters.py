"""Where hands wait, in a few clusters, each with a path of its own."""

from collections.abc import Sequence

import numpy as np
from support.path_search import hits_along

from dynahoi_lerobot.core.spec import EpisodeSpec

SWEEPS = 50


def homes_of(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """Return (N, 3) the homes of episodes [m], world."""
    return np.stack([spec.home_pos_w for spec in specs])


def cluster(homes_w: np.ndarray, count: int) -> np.ndarray:
    """Return (count, 3) the centres of ``count`` clusters of homes (N, 3) [m], world, by Lloyd's algorithm."""
    centres = homes_w[np.random.default_rng(0).choice(len(homes_w), count, replace=False)]
    for _ in range(SWEEPS):
        members = [homes_w[nearest(homes_w, centres) == k] for k in range(count)]
        centres = np.stack([m.mean(axis=0) if len(m) else c for m, c in zip(members, centres, strict=True)])
    return centres


def nearest(homes_w: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return (N,) the index of the centre (C, 3) nearest to each home (N, 3)."""
    return np.linalg.norm(homes_w[:, None] - centres, axis=2).argmin(axis=1)


def hits_by_cluster(homes_w: np.ndarray, targets: np.ndarray, table: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return (N,) bool: the targets (N, F + 1, 3) that the path of the nearest centre meets.

    Args:
        homes_w: (N, 3) [m], world.
        targets: as ``relative_paths`` returns them.
        table: (C, 3) centres [m], world, and (C, K, 3) their paths.
    """
    centres, paths = table
    met, labels = np.zeros(len(homes_w), bool), nearest(homes_w, centres)
    for k, path in enumerate(paths):
        met[labels == k] = hits_along(path, targets[labels == k])
    return met
