"""A regressor on everything that a policy sees but pictures: does a number or a word give the meeting point away?"""

from collections.abc import Sequence

import numpy as np
import torch
from support.path_search import hits_along
from torch import nn

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.conventions import CONTROL_DT, MIN_WINDOW_FRAMES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.batch import WorldBatch

WORLDS = 64
HIDDEN, STEPS, LEARNING_RATE, WEIGHT_DECAY = 64, 80, 3e-3, 0.1
POINT_SCALE_M, TIME_SCALE_S = 0.1, 0.5
"""Units in which errors of point and time are weighed against each other."""
LEAST_SPREAD = 1e-4
"""A number that varies less [m, rad] tells nothing, and its rounding must not be blown up."""


def numbers_seen(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """Return (N, 19) state [m, rad] and length of the window [frames] of each episode's start."""
    rows = []
    for start in range(0, len(specs), WORLDS):
        chunk = specs[start : start + WORLDS]
        observation = _first_observation(chunk)
        windows = np.array([[spec.window_frames / MIN_WINDOW_FRAMES] for spec in chunk])  # counted by ``phase``
        rows.append(np.hstack([observation.state, windows]))
    return np.concatenate(rows)


def words_seen(specs: Sequence[EpisodeSpec], vocabulary: Sequence[str]) -> np.ndarray:
    """Return (N, V) 1 where an instruction holds a word of ``vocabulary``."""
    return np.array([[float(word in _words(spec.task)) for word in vocabulary] for spec in specs])


def vocabulary_of(specs: Sequence[EpisodeSpec]) -> list[str]:
    """Return every word of the instructions, sorted."""
    return sorted({word for spec in specs for word in _words(spec.task)})


def meetings(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """Return (N, 4) the intercept relative to home [m] and its time from control start [s]."""
    points = np.stack([spec.intercept_pos_h for spec in specs])
    times = [[(spec.intercept_frame - spec.window_frames) * CONTROL_DT] for spec in specs]
    return np.hstack([points, times])


def fit(features: np.ndarray, wanted: np.ndarray) -> nn.Module:
    """Return a network from (N, D) features to (N, 4) meetings, in the units of ``_scaled``."""
    torch.manual_seed(0)
    x = torch.as_tensor(features, dtype=torch.float32)
    spread = x.std(0)
    network = nn.Sequential(
        _Standardise(x.mean(0), torch.where(spread > LEAST_SPREAD, spread, torch.inf)),
        nn.Linear(x.shape[1], HIDDEN), nn.SiLU(), nn.Linear(HIDDEN, HIDDEN), nn.SiLU(), nn.Linear(HIDDEN, 4),
    )  # fmt: skip
    optimizer = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    y = torch.as_tensor(wanted / _SCALE, dtype=torch.float32)
    for _ in range(STEPS):
        optimizer.zero_grad()
        nn.functional.smooth_l1_loss(network(x), y).backward()
        optimizer.step()
    return network


def predict(network: nn.Module, features: np.ndarray) -> np.ndarray:
    """Return (N, 4) the meetings, as ``meetings`` does."""
    with torch.no_grad():
        return network(torch.as_tensor(features, dtype=torch.float32)).numpy() * _SCALE


def hits_at(predicted: np.ndarray, targets: np.ndarray, speed_m_s: float) -> np.ndarray:
    """Return (N,) bool: the targets (N, F + 1, 3) met by palms that go straight to ``predicted`` (N, 4).

    They arrive in time, or as soon as they can, and wait there.
    """
    frames = np.arange(1, targets.shape[1])
    distance = np.linalg.norm(predicted[:, :3], axis=1)
    arrival_s = np.maximum(np.maximum(predicted[:, 3], distance / speed_m_s), CONTROL_DT)
    share = np.minimum(frames * CONTROL_DT / arrival_s[:, None], 1.0)  # (N, F)
    paths = share[..., None] * predicted[:, None, :3]
    return np.array([hits_along(path, target[None])[0] for path, target in zip(paths, targets, strict=True)])


class _Standardise(nn.Module):
    """Subtracts a mean and divides by a spread."""

    def __init__(self, mean: torch.Tensor, spread: torch.Tensor) -> None:
        super().__init__()
        self._mean, self._spread = mean, spread

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x - self._mean) / self._spread


_SCALE = np.array([POINT_SCALE_M] * 3 + [TIME_SCALE_S])


def _first_observation(specs: Sequence[EpisodeSpec]) -> Observation:
    batch = WorldBatch(Recipe(), len(specs))
    batch.reset(range(len(specs)), specs)
    return batch.observe(images=False)


def _words(task: str) -> list[str]:
    return task.lower().strip(".").split()
