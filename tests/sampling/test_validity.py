"""The benchmark cannot be solved without seeing and predicting: what baselines score stays below a
bound.
"""

from itertools import batched, chain

import numpy as np
import pytest

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import played


@pytest.mark.slow
def test_targets_lie_on_all_sides_of_the_home(specs: list[EpisodeSpec]):
    """In front more often, as the camera must see them first; but no half-space is the right guess
    for nine of ten.
    """
    directions = np.stack([spec.intercept_pos_w - spec.home_pos_w for spec in specs])
    share_ahead = (directions > 0).mean(axis=0)
    assert (share_ahead > 0.1).all()
    assert (share_ahead < 0.9).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "control", "least", "most"),
    [
        ("hold", "standard", 0, 0),
        ("blind_path", "standard", 0.1, 20),
        ("pursuit", "standard", 0.1, 80),
        ("pursuit", "late", 0.1, 60),
        ("constant_velocity", "late", 0.1, 75),
    ],
)
def test_who_does_not_know_the_path_is_far_from_catching_everything(
    name, control, least, most, specs
):
    episodes = played(Rules(control_class=control), EXPERTS[name](), specs[:22])
    localized = [episode.first_localized is not None for episode in episodes]
    assert least <= 100 * np.mean(localized) <= most


EXPLAINED = 0.15
"""Share of the variance of point and time that is chance or the length of the window, at most; the
home explains more of each (0.28 to 0.42)."""


def numbers_seen(specs: list[EpisodeSpec]) -> np.ndarray:
    """Return (N, 19) state [m, rad] and length of the window [frames] at each episode's start."""
    batch = WorldBatch(Rules(), len(specs))
    batch.reset(range(len(specs)), specs)
    windows = [[spec.window_frames] for spec in specs]
    return np.hstack([batch.observe(images=False).state, windows])


def explained(inputs: np.ndarray, meetings: np.ndarray, n: int) -> np.ndarray:
    """Return (4,) R2 of (N, 4) meetings after the first ``n``, by a ridge regression on the inputs
    (N, D) of the first ``n`` and their squares.
    """
    varying = inputs[:, inputs[:n].std(axis=0) > 1e-4]
    scaled = (varying - varying[:n].mean(axis=0)) / varying[:n].std(axis=0)
    x = np.hstack([np.ones((len(scaled), 1)), scaled, scaled**2])
    weights = np.linalg.solve(x[:n].T @ x[:n] + 10 * np.eye(x.shape[1]), x[:n].T @ meetings[:n])
    return 1 - ((x[n:] @ weights - meetings[n:]) ** 2).mean(axis=0) / meetings[n:].var(axis=0)


@pytest.mark.nightly
@pytest.mark.slow
def test_numbers_and_words_do_not_tell_where_the_target_is_met():
    train = sample_specs(Recipe(), range(440), threads=0)
    specs = [*train, *sample_specs(Recipe(split="test"), range(220))]
    frames = [spec.intercept_frame - spec.window_frames for spec in specs]
    points = [spec.intercept_pos_h for spec in specs]
    meetings = np.column_stack([points, frames])
    numbers = np.concatenate([numbers_seen(list(some)) for some in batched(specs, 64)])
    words = [spec.task.lower().strip(".").split() for spec in specs]
    vocabulary = sorted(set(chain.from_iterable(words[: len(train)])))
    said = [[float(word in told) for word in vocabulary] for told in words]
    homes = [spec.home_pos_w for spec in specs]
    n = len(train)
    assert max(explained(numbers, meetings, n)) <= EXPLAINED
    assert max(explained(np.hstack([numbers, said]), meetings, n)) <= EXPLAINED
    assert min(explained(np.hstack([numbers, homes]), meetings, n)) > EXPLAINED, (
        "the regression would find what there is"
    )
