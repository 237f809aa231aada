"""A regressor on everything that a policy sees but pictures: does a number or a word give the
meeting point away?

It is given what policies observe, in the home frame, and, to show what that frame hides, the home's
position in the world as well.
"""

from collections.abc import Sequence

import numpy as np
import torch
from support.fixed_paths import hits_along, homes_of, relative_paths, search_path
from torch import nn

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.conventions import CONTROL_DT, MIN_WINDOW_FRAMES
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.evaluate.summary import wilson
from dynahoi_lerobot.experts.baselines import fixed_path
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.world.batch import WorldBatch

WORLDS = 64
HIDDEN = 64
STEPS = 80
LEARNING_RATE = 3e-3
WEIGHT_DECAY = 0.1
POINT_SCALE_M, TIME_SCALE_S = 0.1, 0.5
"""Units in which errors of point and time are weighed against each other."""
LEAST_SPREAD = 1e-4
"""A number that varies less [m, rad] tells nothing, and its rounding must not be blown up."""
SPEED_M_S = CONTROL_CLASSES["standard"].palm_speed_m_s
FRAMES, WIDTH, FINENESS = 80, 64, 2
"""Of the paths that are searched: length, and see ``search_path``."""
Rate = dict[str, float | list[float]]


def sightless(train: Sequence[EpisodeSpec], split: Sequence[EpisodeSpec]) -> dict[str, Rate]:
    """Print and return what is met in ``split`` by regressors and fixed paths that have seen
    ``train``.

    R2 is the share of the variance of the meeting point (x, y, z) and time that a regressor
    explains, S_loc that of a hand that goes there straight at the standard limit, and waits. Paths
    by motion are the best fixed paths of each kind, for the episodes whose instruction names the
    kind. Only the first observations are simulated.
    """
    table = {
        f"regressor, {name}": regression(*inputs, train, split)
        for name, inputs in variants(train, split).items()
    }
    for control in ("standard", "unlimited"):
        table[f"blind_path, {control}"] = rate(
            hits_along(fixed_path(control), relative_paths(split, FRAMES)).tolist()
        )
    table["paths by motion"] = rate(paths_by_motion(train, split).tolist())
    for name, row in table.items():
        told = f"  R2 {np.round(row['R2'], 2)}" if "R2" in row else ""
        print(f"{name:34s} S_loc {row['value']:5.1f} [{row['low']:5.1f}, {row['high']:5.1f}]{told}")
    return table


def rate(outcomes: Sequence[bool]) -> Rate:
    """Return a share and its interval [%]."""
    low, high = wilson(sum(outcomes), len(outcomes))
    return {
        "value": 100 * sum(outcomes) / len(outcomes),
        "low": 100 * low,
        "high": 100 * high,
        "n": len(outcomes),
    }


def variants(
    train: Sequence[EpisodeSpec], split: Sequence[EpisodeSpec]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the inputs of each regressor, (N, D) of training and of the split."""
    vocabulary = vocabulary_of(train)
    numbers, words, homes = (
        (part(train), part(split))
        for part in (numbers_seen, lambda s: words_seen(s, vocabulary), homes_of)
    )
    chosen = {
        "numbers": (numbers,),
        "numbers and words": (numbers, words),
        "numbers and home": (numbers, homes),
        "numbers, words and home": (numbers, words, homes),
    }
    return {
        name: (np.hstack([p[0] for p in parts]), np.hstack([p[1] for p in parts]))
        for name, parts in chosen.items()
    }


def regression(
    seen: np.ndarray, asked: np.ndarray, train: Sequence[EpisodeSpec], split: Sequence[EpisodeSpec]
) -> Rate:
    """Train on (N, D) inputs ``seen``; return what is explained and met of those of the split, (M,
    D) ``asked``.
    """
    predicted = predict(fit(seen, meetings(train)), asked)
    true = meetings(split)
    explained = 1 - ((predicted - true) ** 2).sum(axis=0) / ((true - true.mean(axis=0)) ** 2).sum(
        axis=0
    )
    return {
        **rate(hits_at(predicted, relative_paths(split, FRAMES), SPEED_M_S).tolist()),
        "R2": explained.tolist(),
    }


def paths_by_motion(train: Sequence[EpisodeSpec], split: Sequence[EpisodeSpec]) -> np.ndarray:
    """Return (M,) bool: what the best path of its kind meets, or the fixed path where no
    instruction names the kind.
    """
    targets = relative_paths(split, FRAMES)
    searched = relative_paths(train, FRAMES)
    met = hits_along(fixed_path("standard"), targets)
    kinds = np.array([spec.motion.name for spec in train])
    for kind in sorted(set(kinds)):
        path = search_path(searched[kinds == kind], SPEED_M_S, WIDTH, FINENESS)
        told = np.array(
            [spec.motion.name == kind and spec.motion.phrase in spec.task for spec in split]
        )
        met[told] = hits_along(path, targets[told])
    return met


def numbers_seen(specs: Sequence[EpisodeSpec]) -> np.ndarray:
    """Return (N, 19) state [m, rad] and length of the window [frames] of each episode's start."""
    rows = []
    for start in range(0, len(specs), WORLDS):
        chunk = specs[start : start + WORLDS]
        observation = _first_observation(chunk)
        windows = np.array(
            [[spec.window_frames / MIN_WINDOW_FRAMES] for spec in chunk]
        )  # counted by ``phase``
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
        nn.Linear(x.shape[1], HIDDEN),
        nn.SiLU(),
        nn.Linear(HIDDEN, HIDDEN),
        nn.SiLU(),
        nn.Linear(HIDDEN, 4),
    )
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
    """Return (N,) bool: the targets (N, F + 1, 3) met by palms that go straight to ``predicted``
    (N, 4).

    They arrive in time, or as soon as they can, and wait there.
    """
    frames = np.arange(1, targets.shape[1])
    distance = np.linalg.norm(predicted[:, :3], axis=1)
    arrival_s = np.maximum(np.maximum(predicted[:, 3], distance / speed_m_s), CONTROL_DT)
    share = np.minimum(frames * CONTROL_DT / arrival_s[:, None], 1.0)  # (N, F)
    paths = share[..., None] * predicted[:, None, :3]
    return np.array(
        [hits_along(path, target[None])[0] for path, target in zip(paths, targets, strict=True)]
    )


class _Standardise(nn.Module):
    """Subtracts a mean and divides by a spread."""

    def __init__(self, mean: torch.Tensor, spread: torch.Tensor) -> None:
        super().__init__()
        self._mean = mean
        self._spread = spread

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x - self._mean) / self._spread


_SCALE = np.array([POINT_SCALE_M] * 3 + [TIME_SCALE_S])


def _first_observation(specs: Sequence[EpisodeSpec]) -> Observation:
    batch = WorldBatch(Rules(), len(specs))
    batch.reset(range(len(specs)), specs)
    return batch.observe(images=False)


def _words(task: str) -> list[str]:
    return task.lower().strip(".").split()
