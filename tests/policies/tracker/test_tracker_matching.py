"""A hand that arrives at the target's velocity."""

from __future__ import annotations

import pytest
import torch
from lerobot_policy_tracker.matching import CLOSING_SPEED_M_S, matched_path
from lerobot_policy_tracker.reach import Reach
from tracker_helpers import make_policy

FPS = 20.0
REACH = Reach(palm_step_m=0.075, joint_step_rad=1.0, spare_frames=0, closing_frames=1)
START = torch.tensor([0.3, 0.1, -0.05])


def moving(velocity: tuple[float, float, float], frames: int = 30) -> torch.Tensor:
    """A straight path ``(1, F + 1, 3)`` at a velocity [m/s]."""
    return (START + torch.arange(frames + 1)[:, None] / FPS * torch.tensor(velocity))[None]


def meeting_of(palm: torch.Tensor, path: torch.Tensor) -> int:
    return int((palm - path)[0].norm(dim=-1).lt(1e-6).int().argmax())


def test_the_palm_arrives_at_the_targets_velocity_and_a_little_faster_along_its_normal():
    path = moving((-0.2, 0.4, 0.1))
    palm = matched_path(path, REACH, FPS)
    met = meeting_of(palm, path)
    before = FPS * (palm - path)[0].diff(dim=0)[met - 1]
    assert met > 3
    assert before[0].item() == pytest.approx(CLOSING_SPEED_M_S, abs=0.15)
    assert before[1:].abs().max() < 0.15
    torch.testing.assert_close(palm[0, met:], path[0, met:])
    assert palm[0, 0].abs().max() < 1e-6, "it starts where the hand is"


def test_no_step_is_longer_than_the_hand_can_go():
    for velocity in ((0.0, 0.0, 0.0), (-0.2, 0.4, 0.1), (0.5, -0.8, 0.0)):
        path = moving(velocity)
        palm = matched_path(path, REACH, FPS)
        assert palm.diff(dim=1).norm(dim=-1).max() <= REACH.palm_step_m + 1e-6


def test_a_hand_that_plans_anew_in_every_frame_goes_on_as_planned():
    path = moving((-0.2, 0.4, 0.1))
    palm = matched_path(path, REACH, FPS)
    again = matched_path(path[:, 1:] - palm[:, 1:2], REACH, FPS) + palm[:, 1:2]
    torch.testing.assert_close(again, palm[:, 1:], rtol=0, atol=1e-5)


def test_a_target_is_met_where_it_is_slow():
    """A ball thrown straight up is faster than the hand before and after, and stands still between."""
    time_s = torch.arange(31) / FPS
    height = 4.0 * time_s - 9.81 * time_s.square() / 2 - 0.8
    path = START + torch.stack([torch.zeros(31), torch.zeros(31), height], dim=-1)[None]
    palm = matched_path(path, REACH, FPS)
    top = int(height.argmax())
    assert abs(meeting_of(palm, path) - top) <= 1


def test_an_unknown_arrival_is_refused():
    with pytest.raises(ValueError, match="arrival is 'fast', but must be one of straight, matched"):
        make_policy(head="intercept", head_options={"arrival": "fast"})
