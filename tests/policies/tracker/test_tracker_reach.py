"""Where a hand of limited speed meets a path, beside the privileged expert that knows the path."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from lerobot_policy_tracker.heads.intercept import KNOTS, interpolation
from lerobot_policy_tracker.reach import Reach, close_in_time, earliest_meeting, first_contact, palm_path

from dynahoi_lerobot.core.conventions import CONTROL_DT, LOCALIZATION_RADIUS_M
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

REACH = Reach(palm_step_m=0.025, joint_step_rad=1.0, spare_frames=2, closing_frames=8)


def still(x: float, frames: int = 20) -> torch.Tensor:
    return torch.tensor([x, 0.0, 0.0]).expand(1, frames + 1, 3)


def test_a_target_that_waits_is_met_when_the_hand_can_be_there():
    meeting = earliest_meeting(still(0.1), torch.zeros(1), REACH)
    assert meeting.frames.item() == 4
    torch.testing.assert_close(meeting.offset, torch.tensor([[0.1, 0.0, 0.0]]))


def test_it_is_met_no_sooner_than_the_fingers_can_close():
    assert earliest_meeting(still(0.1), torch.full((1,), 6.5), REACH).frames.item() == 8


def test_what_is_out_of_reach_is_met_as_late_as_it_is_known():
    assert earliest_meeting(still(9.0), torch.zeros(1), REACH).frames.item() == 20


def test_the_palm_goes_straight_at_its_limit_waits_and_then_stays_with_the_target():
    path = torch.cat([still(0.06, 9), still(0.5, 9)], dim=1)
    meeting = earliest_meeting(path, torch.full((1,), 4.0), REACH)
    palm = palm_path(path, meeting, REACH)[0, :, 0]
    assert meeting.frames.item() == 5
    torch.testing.assert_close(palm[:6], torch.tensor([0.0, 0.025, 0.05, 0.06, 0.06, 0.06]))
    torch.testing.assert_close(palm[6:], path[0, 6:, 0])


def test_a_target_that_flies_through_the_hand_between_two_frames_is_not_missed():
    path = torch.tensor([[-0.3, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.3, 0.0, 0.0]])[None]
    assert first_contact(torch.zeros_like(path), path).item() == 2


def test_fingers_stay_open_then_close_evenly_and_in_time():
    steps = close_in_time(torch.zeros(1, 1), torch.ones(1, 1), torch.tensor([12]), 14, REACH)[0, :, 0]
    assert steps[:2].abs().max() == 0, "12 frames left, of which 2 are spare: more than 8 to close"
    assert steps[9] == pytest.approx(1.0)
    assert steps[:10].diff().min() >= 0
    assert steps[:10].diff().max() < 0.13


def test_a_hand_that_knows_the_path_catches_every_target_of_the_benchmark():
    specs = sample_specs(Recipe(split="val"), range(44))
    assert all(_caught(spec) for spec in specs)


def _caught(spec) -> bool:
    palm, path = spec.home_pos_w, spec.oracle_path
    for frame in range(spec.window_frames, len(path) - 2):
        ahead = torch.from_numpy(path[frame:] - palm).float()[None]
        step = palm_path(ahead, earliest_meeting(ahead, torch.zeros(1), REACH), REACH)[0, 1].numpy()
        assert np.linalg.norm(step) <= 0.5 * CONTROL_DT + 1e-6
        gaps = np.linspace(path[frame] - palm, path[frame + 1] - palm - step, 6)
        if (np.linalg.norm(gaps, axis=1) < LOCALIZATION_RADIUS_M).any():
            return True
        palm = palm + step
    return False


def test_between_knots_the_path_is_straight():
    knots = torch.tensor(KNOTS, dtype=torch.float32)
    torch.testing.assert_close(interpolation(KNOTS) @ knots, torch.arange(KNOTS[-1] + 1.0))
    assert (interpolation(KNOTS)[list(KNOTS)] - torch.eye(len(KNOTS))).abs().max() < 1e-6


def test_fingers_that_nothing_attaches_close_at_contact_and_not_before():
    reach = Reach(palm_step_m=0.025, joint_step_rad=1.0, spare_frames=0, closing_frames=1)
    joints, closed = torch.zeros(1, 1), torch.ones(1, 1)
    steps = close_in_time(joints, closed, torch.tensor([3]), 4, reach)[0, :, 0]
    assert steps.tolist() == [0.0, 0.0, 1.0, 1.0]
