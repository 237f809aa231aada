"""A chunk is corrected for what is seen while it is executed, and for nothing else."""

from __future__ import annotations

import pytest
import torch
from lerobot_policy_tracker.correction import corrected_path
from lerobot_policy_tracker.sightings import Sightings
from test_tracker_latency import acting_policy, acting_step
from tracker_helpers import make_policy, make_step, phase_of

FPS, LAST = 20.0, 30
ALONG_X = torch.tensor([1.0, 0.0, 0.0])


def straight(speed_m_s: float, begin: float = 0.3) -> torch.Tensor:
    """(1, LAST + 1, 3) a target that goes along y, begin metres in front of the palm."""
    frames = torch.arange(LAST + 1)
    return torch.stack(
        [torch.full_like(frames, begin, dtype=torch.float32), speed_m_s * frames / FPS, 0.0 * frames], -1
    )[None]


def sightings(path: torch.Tensor, age: int, across_m: float = 1e-3, along_m: float = 1e-3) -> Sightings:
    """What one eye at the origin sees of a path from frame 0 to ``age``."""
    points = path[:, : age + 1, None]
    return Sightings(points, points, torch.tensor([across_m, along_m]).expand(*points.shape[:3], 2))


def corrected(expected: torch.Tensor, seen: Sightings, age: int) -> torch.Tensor:
    return corrected_path(expected, seen, torch.full((len(expected),), age), FPS)


def test_what_was_expected_stays_where_nothing_contradicts_it():
    path = straight(0.5)
    later = corrected(path, sightings(path, 6), 6)
    torch.testing.assert_close(later[:, : LAST - 5], path[:, 6:])
    assert (later[:, LAST - 5 :] == later[:, LAST - 6 : LAST - 5]).all(), "beyond what is expected nothing changes"


def test_the_frame_that_a_chunk_was_planned_from_tells_nothing_new():
    expected, true = straight(0.5), straight(0.5, begin=0.4)
    torch.testing.assert_close(corrected(expected, sightings(true, 0), 0), expected)


@pytest.mark.parametrize(("true", "tolerance_m"), [(straight(0.5, begin=0.31), 0.001), (straight(0.8), 0.006)])
def test_a_path_that_goes_elsewhere_or_faster_is_followed(true: torch.Tensor, tolerance_m: float):
    expected = straight(0.5)
    later = corrected(expected, sightings(true, 8), 8)[:, :10]
    gap = (later - true[:, 8:18]).norm(dim=-1).max()
    assert gap < tolerance_m
    assert (expected[:, 8:18] - true[:, 8:18]).norm(dim=-1).max() > 8 * tolerance_m


def test_a_distance_that_the_eye_cannot_tell_is_not_believed():
    expected, true = straight(0.0), straight(0.0, begin=0.5)
    blurred = corrected(expected, sightings(true, 8, along_m=3.0), 8)
    assert (blurred[0, 0] - expected[0, 0]).norm() < 0.001
    sharp = corrected(expected, sightings(true, 8), 8)
    assert (sharp[0, 0] - true[0, 0]).norm() < 0.001


def test_what_was_not_seen_changes_nothing():
    expected, true = straight(0.5), straight(0.5, begin=0.6)
    unseen = sightings(true, 5, torch.inf, torch.inf)
    torch.testing.assert_close(corrected(expected, unseen, 5)[:, :20], expected[:, 5:25])


def test_rows_have_ages_of_their_own():
    expected, true = straight(0.5), straight(0.6, begin=0.32)
    both = sightings(true.expand(2, -1, -1), 7)
    together = corrected_path(expected.expand(2, -1, -1), both, torch.tensor([7, 3]), FPS)
    latest = Sightings(both.points[1:, 4:], both.rays[1:, 4:], both.errors_m[1:, 4:])
    alone = corrected(expected, latest, 3)
    torch.testing.assert_close(together[1:], alone)
    assert not torch.allclose(together[0], together[1])


def test_a_new_chunk_needs_no_correction():
    policy = acting_policy()
    step = acting_step(policy)
    chunk = policy.predict_action_chunk(step)
    rows = [0, 1, 2]
    actions = policy.corrected_action(rows, policy.expectations(rows), [0, 0, 0])
    torch.testing.assert_close(actions, chunk[:, 0])


def test_a_corrected_action_depends_on_what_is_seen_later():
    def after(*seeds: int) -> torch.Tensor:
        policy = acting_policy()
        policy.predict_action_chunk(acting_step(policy))
        expectations = policy.expectations([0, 2])
        for seed in seeds:
            policy.observe(make_step(policy, seed=seed) | {"observation.phase": phase_of(torch.ones(3))})
        return policy.corrected_action([0, 2], expectations, [len(seeds)] * 2)

    assert after(5, 6).shape == (2, 18)
    torch.testing.assert_close(after(5, 6), after(5, 6))
    assert not torch.allclose(after(5, 6), after(7, 6))


def test_only_heads_that_forecast_correct_and_only_where_commands_are_not_late():
    assert acting_policy().corrects
    assert not make_policy().corrects
    assert not acting_policy(latency_frames=3, n_action_steps=1).corrects
