"""Where hands wait, in a few clusters, and the best path of a hand that sees nothing for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec

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


def paths_by_cluster(
    homes_w: np.ndarray, targets: np.ndarray, centres: np.ndarray, search: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return (C, K, 3) for each centre the path (K, 3) that ``search`` finds for the targets of its homes."""
    labels = nearest(homes_w, centres)
    return np.stack([search(targets[labels == k]) for k in range(len(centres))])


def hits_by_cluster(
    homes_w: np.ndarray,
    targets: np.ndarray,
    table: tuple[np.ndarray, np.ndarray],
    hits: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return (N,) bool: the targets (N, F + 1, 3) that the path of the nearest centre meets.

    Args:
        homes_w: (N, 3) [m], world.
        targets: as ``relative_paths`` returns them.
        table: (C, 3) centres and (C, K, 3) their paths.
        hits: tells which targets a path meets.
    """
    centres, paths = table
    met, labels = np.zeros(len(homes_w), bool), nearest(homes_w, centres)
    for k, path in enumerate(paths):
        met[labels == k] = hits(path, targets[labels == k])
    return met
