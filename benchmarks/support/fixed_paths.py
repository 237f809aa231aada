"""The best path of a hand that sees nothing: a beam search over directions, frame by frame, on many
episodes.

Hands that know where they wait may have one for each of a few clusters of homes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, LOCALIZATION_RADIUS_M
from dynahoi_lerobot.core.spec import EpisodeSpec

CELL_M = 0.01
"""Of two paths that end in the same cell only the better one is kept."""
FAR_M = 1e3
"""Where the target of an episode that has ended is put."""
SWEEPS = 50
"""Of Lloyd's algorithm."""


@dataclass(frozen=True)
class Beam:
    """The paths kept so far.

    Attributes:
        paths: (B, k, 3) palm positions relative to home [m] after 1 to k control steps.
        hits: (B, N) bool, the episodes in which a path has met the target.
    """

    paths: np.ndarray
    hits: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """(B, 3) where the paths have come to."""
        return self.paths[:, -1] if self.paths.shape[1] else np.zeros((len(self.paths), 3))


def relative_paths(specs: Sequence[EpisodeSpec], frames: int) -> np.ndarray:
    """Return (N, frames + 1, 3) the untouched targets relative to the hands' homes [m], from
    control start on.
    """
    paths = np.full((len(specs), frames + 1, 3), FAR_M)
    for path, spec in zip(paths, specs, strict=True):
        control = (
            spec.target_path_w[spec.window_frames : spec.window_frames + spec.length_frames + 1]
            - spec.home_pos_w
        )
        path[: len(control)] = control[: frames + 1]
    return paths


def search_path(targets: np.ndarray, speed_m_s: float, width: int, fineness: int) -> np.ndarray:
    """Return (frames, 3) the palm positions relative to home [m] that meet most targets.

    Args:
        targets: (N, frames + 1, 3) from ``relative_paths``.
        speed_m_s: speed limit of the palm; every step is at full speed, or none.
        width: number of paths kept.
        fineness: half the number of grid lines along each edge of the cube on whose surface
            directions lie.
    """
    steps = speed_m_s * CONTROL_DT * _directions(fineness)
    beam = Beam(np.zeros((1, 0, 3)), np.zeros((1, len(targets)), bool))
    for before, after in zip(
        *(np.moveaxis(part, 1, 0) for part in (targets[:, :-1], targets[:, 1:])), strict=True
    ):
        beam = _extend(beam, before, after, steps, width)
    return beam.paths[0]


def hits_along(path: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return (N,) bool: the targets (N, F + 1, 3) that a path (K, 3) of palm positions meets."""
    palm = np.concatenate([np.zeros((1, 3)), path])[: targets.shape[1]]
    start = palm[:-1] - targets[:, : len(palm) - 1]
    moves = np.diff(palm, axis=0) - np.diff(targets[:, : len(palm)], axis=1)
    return np.any(_meets(start, moves), axis=1)


def _directions(fineness: int) -> np.ndarray:
    """(D, 3) unit vectors through a grid on the surface of a cube, and zero."""
    grid = np.arange(-fineness, fineness + 1)
    points = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    surface = points[np.abs(points).max(axis=1) == fineness]
    return np.concatenate(
        [surface / np.linalg.norm(surface, axis=1, keepdims=True), np.zeros((1, 3))]
    )


def _extend(
    beam: Beam, before: np.ndarray, after: np.ndarray, steps: np.ndarray, width: int
) -> Beam:
    """Let every path take every step (D, 3) while targets (N, 3) move on; keep the ``width``
    best.
    """
    ends = beam.ends
    parents, episodes = np.nonzero(_within_a_step(ends, before, after, steps) & ~beam.hits)
    start = (ends[parents] - before[episodes])[:, None]  # (P, 1, 3)
    met = _meets(start, steps - (after - before)[episodes][:, None])  # (P, D)
    gains = np.zeros((len(ends), len(steps)), int)
    np.add.at(gains, parents, met)
    kept = _best(beam.hits.sum(axis=1)[:, None] + gains, ends[:, None] + steps, width)
    parent, step = np.unravel_index(kept, gains.shape)
    hits = beam.hits[parent]
    for row, (p, s) in zip(hits, zip(parent, step, strict=True), strict=True):
        row[episodes[(parents == p) & met[:, s]]] = True
    return Beam(
        np.concatenate([beam.paths[parent], (ends[parent] + steps[step])[:, None]], axis=1), hits
    )


def _within_a_step(
    ends: np.ndarray, before: np.ndarray, after: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """(B, N) bool: whether any step from an end could meet a target."""
    reach = (
        LOCALIZATION_RADIUS_M
        + np.linalg.norm(steps, axis=1).max()
        + np.linalg.norm(after - before, axis=1)
    )
    return np.linalg.norm(ends[:, None] - before, axis=2) < reach


def _meets(start: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """(...) bool: whether straight relative moves (..., 3) from (..., 3) come within the
    localization radius of 0.
    """
    length = np.maximum((moves**2).sum(axis=-1), 1e-12)
    share = np.clip(-(start * moves).sum(axis=-1) / length, 0.0, 1.0)
    return np.linalg.norm(start + share[..., None] * moves, axis=-1) < LOCALIZATION_RADIUS_M


def _best(scores: np.ndarray, ends: np.ndarray, width: int) -> np.ndarray:
    """Flat indices into (B, D) scores of the ``width`` highest whose ends (B, D, 3) lie in
    different cells.
    """
    order = np.argsort(-scores, axis=None, kind="stable")
    cells = np.round(ends.reshape(-1, 3)[order] / CELL_M).astype(int)
    _, first = np.unique(cells, axis=0, return_index=True)
    return order[np.sort(first)[:width]]


def homes_of(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """Return (N, 3) the homes of episodes [m], world."""
    return np.stack([spec.home_pos_w for spec in specs])


def cluster(homes_w: np.ndarray, count: int) -> np.ndarray:
    """Return (count, 3) the centers of ``count`` clusters of homes (N, 3) [m], world, by Lloyd's
    algorithm.
    """
    centers = homes_w[np.random.default_rng(0).choice(len(homes_w), count, replace=False)]
    for _ in range(SWEEPS):
        members = [homes_w[nearest(homes_w, centers) == k] for k in range(count)]
        centers = np.stack(
            [m.mean(axis=0) if len(m) else c for m, c in zip(members, centers, strict=True)]
        )
    return centers


def nearest(homes_w: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Return (N,) the index of the center (C, 3) nearest to each home (N, 3)."""
    return np.linalg.norm(homes_w[:, None] - centers, axis=2).argmin(axis=1)


def hits_by_cluster(
    homes_w: np.ndarray, targets: np.ndarray, table: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return (N,) bool: the targets (N, F + 1, 3) that the path of the nearest center meets.

    Args:
        homes_w: (N, 3) [m], world.
        targets: as ``relative_paths`` returns them.
        table: (C, 3) centers [m], world, and (C, K, 3) their paths.
    """
    centers, paths = table
    met = np.zeros(len(homes_w), bool)
    labels = nearest(homes_w, centers)
    for k, path in enumerate(paths):
        met[labels == k] = hits_along(path, targets[labels == k])
    return met
