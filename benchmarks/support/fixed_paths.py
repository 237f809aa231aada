"""The best path of a hand that sees nothing: a beam search over directions, frame by frame, on many
episodes.

Hands that know where they wait may have one for each of a few clusters of homes. Targets and palm
are taken to move straight between frames; nothing is simulated.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.cluster.vq import kmeans2, vq

from dynahoi_lerobot.core.conventions import CONTROL_DT, LOCALIZATION_RADIUS_M
from dynahoi_lerobot.core.spec import EpisodeSpec

FRAMES = 80
"""Length of a path."""
WIDTH = 64
"""Paths kept from frame to frame."""
FINENESS = 2
"""Half the number of grid lines along each edge of the cube on whose surface directions lie."""
CELL_M = 0.01
"""Of two paths that end in the same cell only the better one is kept."""
FAR_M = 1e3
"""Where the target of an episode that has ended is put."""
SWEEPS = 50
"""Of Lloyd's algorithm."""


def search_paths(
    specs: Sequence[EpisodeSpec], clusters: int, speed_m_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, 3) the centers of clusters of homes [m], world, and (C, FRAMES, 3) the path found
    for each, palm positions relative to home [m].
    """
    homes_w = _homes(specs)
    first = np.random.default_rng(0).choice(len(homes_w), clusters, replace=False)
    centers, _ = kmeans2(homes_w, homes_w[first], iter=SWEEPS, minit="matrix")
    labels, _ = vq(homes_w, centers)
    targets = _relative_paths(specs)
    paths = [_search_path(targets[labels == k], speed_m_s) for k in range(clusters)]
    return centers, np.stack(paths)


def met_by_nearest(
    specs: Sequence[EpisodeSpec], centers: np.ndarray, paths: np.ndarray
) -> np.ndarray:
    """Return (N,) bool: the episodes whose target is met by the path (C, FRAMES, 3) of the center
    (C, 3) nearest to their home.
    """
    labels, _ = vq(_homes(specs), centers)
    palm = np.concatenate([np.zeros((len(paths), 1, 3)), paths], axis=1)[labels]
    targets = _relative_paths(specs)
    moves = np.diff(palm, axis=1) - np.diff(targets, axis=1)
    return np.any(_meets((palm - targets)[:, :-1], moves), axis=1)


def _homes(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """(N, 3) the homes of episodes [m], world."""
    return np.stack([spec.home_pos_w for spec in specs])


def _relative_paths(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """(N, FRAMES + 1, 3) the untouched targets relative to the hands' homes [m], from control start
    on.
    """
    paths = np.full((len(specs), FRAMES + 1, 3), FAR_M)
    for path, spec in zip(paths, specs, strict=True):
        begin = spec.window_frames
        end = begin + min(spec.length_frames, FRAMES) + 1
        control = spec.target_path_w[begin:end] - spec.home_pos_w
        path[: len(control)] = control
    return paths


def _search_path(targets: np.ndarray, speed_m_s: float) -> np.ndarray:
    """(FRAMES, 3) the palm positions relative to home [m] that meet most targets.

    Args:
        targets: (N, FRAMES + 1, 3) from ``_relative_paths``.
        speed_m_s: speed limit of the palm; every step is at full speed, or none.
    """
    steps = speed_m_s * CONTROL_DT * _directions()
    paths = np.zeros((1, 1, 3))  # (B, k + 1, 3) after k control steps
    met = np.zeros((1, len(targets)), bool)  # (B, N), the targets that each has met
    for before, after in pairwise(np.moveaxis(targets, 1, 0)):
        fresh = _met_by_steps(paths[:, -1], met, before, after, steps)
        ends = paths[:, -1:] + steps
        scores = met.sum(axis=1)[:, None] + fresh.sum(axis=1)
        parent, step = np.unravel_index(_best(scores, ends), scores.shape)
        paths = np.concatenate([paths[parent], ends[parent, step][:, None]], axis=1)
        met = met[parent] | fresh[parent, :, step]
    return paths[0, 1:]


def _directions() -> np.ndarray:
    """(D, 3) unit vectors through a grid on the surface of a cube, and zero."""
    grid = np.arange(-FINENESS, FINENESS + 1)
    points = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    surface = points[np.abs(points).max(axis=1) == FINENESS]
    units = surface / np.linalg.norm(surface, axis=1, keepdims=True)
    return np.concatenate([units, np.zeros((1, 3))])


def _met_by_steps(
    ends: np.ndarray, met: np.ndarray, before: np.ndarray, after: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """(B, N, D) bool: the targets that a path (B, 3) which has not ``met`` (B, N) them meets by a
    step (D, 3), while they move from ``before`` to ``after`` (N, 3).
    """
    farthest_m = np.linalg.norm(steps, axis=1).max() + np.linalg.norm(after - before, axis=1)
    near = np.linalg.norm(ends[:, None] - before, axis=2) < LOCALIZATION_RADIUS_M + farthest_m
    paths, targets = np.nonzero(near & ~met)
    start = (ends[paths] - before[targets])[:, None]  # (P, 1, 3)
    fresh = np.zeros((*met.shape, len(steps)), bool)
    fresh[paths, targets] = _meets(start, steps - (after - before)[targets][:, None])
    return fresh


def _meets(start: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """(...) bool: whether straight relative moves (..., 3) from (..., 3) come within the
    localization radius of 0.
    """
    length = np.maximum((moves**2).sum(axis=-1), 1e-12)
    share = np.clip(-(start * moves).sum(axis=-1) / length, 0.0, 1.0)
    return np.linalg.norm(start + share[..., None] * moves, axis=-1) < LOCALIZATION_RADIUS_M


def _best(scores: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Flat indices into (B, D) scores of the ``WIDTH`` highest whose ends (B, D, 3) lie in
    different cells.
    """
    order = np.argsort(-scores, axis=None, kind="stable")
    cells = np.round(ends.reshape(-1, 3)[order] / CELL_M).astype(int)
    _, first = np.unique(cells, axis=0, return_index=True)
    return order[np.sort(first)[:WIDTH]]
