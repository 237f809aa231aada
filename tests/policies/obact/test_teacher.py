"""The teacher's closed form against a search, frame by frame."""

import numpy as np
import pytest
import torch
from lerobot_policy_obact.dataset import RADIUS_M as RADIUS_BY_RULE
from lerobot_policy_obact.frames import stepped
from lerobot_policy_obact.teacher import (
    CLOSED_FRAMES,
    CLOSING_FRAMES,
    PLANNED_SPEED,
    SLACK,
    Answers,
    Targets,
    passing_distance,
)  # fmt: skip

from dynahoi_lerobot.captures import CAPTURES
from tests.policies.obact.test_windows import RADIUS_M, STEP_M, teacher


def targets_on(path: torch.Tensor) -> Targets:
    length = torch.full((len(path),), path.shape[1])
    return Targets(path, length, length, torch.zeros(len(path), dtype=torch.bool))


def answers(
    path: torch.Tensor, due: torch.Tensor, palms: torch.Tensor, horizon: int = 1
) -> Answers:
    return teacher().answer(targets_on(path), due, palms, horizon)


def paths(n: int, frames: int = 60) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(n, 1, 3, generator=generator) * 0.3
    velocity = torch.randn(n, 1, 3, generator=generator) * 0.01
    return start + velocity * torch.arange(frames)[:, None]


def searched(path: torch.Tensor, due: int, palm: torch.Tensor, share: float) -> int | None:
    """The first number of frames in which the palm gets near enough to the path at a share of its
    full speed.
    """
    for ahead in range(1, len(path) - due):
        if (path[due + ahead] - palm).norm() <= share * STEP_M * ahead + SLACK * RADIUS_M:
            return ahead
    return None


def test_it_meets_the_target_at_the_first_point_in_reach_with_time_to_spare_if_there_is_one():
    path = paths(20)
    due = torch.randint(0, 30, (20, 4))
    palms = torch.randn(20, 4, 3, 3) * 0.2
    told = answers(path, due, palms)
    for b, q, m in np.ndindex(20, 4, 3):
        calm, found = (
            searched(path[b], int(due[b, q]), palms[b, q, m], share)
            for share in (PLANNED_SPEED, 1.0)
        )
        assert bool(told.reachable[b, q, m]) == (found is not None)
        if found is not None:
            assert int(told.frames_left[b, q, m]) == (calm or found)
            assert torch.equal(told.goal[b, q, m, 0], path[b, int(due[b, q]) + (calm or found)])


@pytest.mark.parametrize(
    ("start_m", "speed_m", "due", "frames"),
    [(5.0, 0.0, 10, 29), (5.0, 0.03, 10, 1), (0.035, 1.1 * STEP_M, 0, 1)],
)
def test_out_of_reach_it_goes_where_it_is_the_least_late(
    start_m: float, speed_m: float, due: int, frames: int
):
    """A target that rests far away, one that flees, and a faster one close ahead, to which the gap
    is closed.
    """
    path = torch.tensor([start_m, 0, 0]) + torch.arange(40)[:, None] * torch.tensor([speed_m, 0, 0])
    told = answers(path[None], torch.tensor([[due]]), torch.zeros(1, 1, 1, 3))
    assert not told.reachable.any()
    assert int(told.frames_left) == frames


def test_the_radius_is_that_of_the_rule_of_capture():
    known = {
        name: CAPTURES[name].localization_radius_m
        for name in CAPTURES.names()
        if CAPTURES[name].welds
    }
    assert pytest.approx(known) == RADIUS_BY_RULE


def test_fingers_are_closed_before_the_meeting_and_open_long_before():
    path = torch.tensor([[[1.0, 0, 0]]]).expand(1, 100, 3)
    closing = answers(path, torch.tensor([[0]]), torch.zeros(1, 1, 1, 3), 50).closing
    left = 47 - torch.arange(50)  # 0.985 m at 0.85 of 2.5 cm a frame
    assert (closing[0, 0, 0, left <= CLOSED_FRAMES] == 1).all()
    assert (closing[0, 0, 0, left >= CLOSED_FRAMES + CLOSING_FRAMES] == 0).all()
    assert (closing[0, 0, 0].diff() >= 0).all()


def test_the_first_hand_is_the_one_that_was_there_and_the_others_are_near_it_or_the_target():
    torch.manual_seed(0)
    path = paths(50)
    due = torch.full((50, 2), 20)
    state = torch.randn(50, 2, 18) * 0.1
    hands = teacher().hands(targets_on(path), due, state)
    assert torch.equal(hands[:, :, 0], state)
    palm = state[..., :3]
    for i, near in ((1, palm), (2, palm), (3, path[:, 20][:, None])):
        assert 0.01 < (hands[:, :, i, :3] - near).norm(dim=-1).median() < 0.15
        assert torch.equal(hands[:, :, i, 3:], state[..., 3:])


def test_a_palm_goes_no_farther_than_it_can_and_stops_where_it_should():
    goals = torch.tensor([[1.0, 0, 0], [0.0, 0.01, 0], [0.0, 0, 0]])
    reached = stepped(torch.zeros(3, 3), goals, STEP_M)
    torch.testing.assert_close(reached, torch.tensor([[STEP_M, 0, 0], [0, 0.01, 0], [0, 0, 0]]))


def test_two_that_pass_each_other_between_frames_are_as_near_as_they_come():
    start = torch.tensor([[1.0, 0.2, 0], [1.0, 0, 0]])
    end = torch.tensor([[-1.0, 0.2, 0], [2.0, 0, 0]])
    torch.testing.assert_close(
        passing_distance(start, end), torch.tensor([0.2, 1.0]), atol=1e-4, rtol=0
    )
