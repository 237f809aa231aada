"""The teacher's closed form against a search, frame by frame, and against the expert that records the data."""

import numpy as np
import pytest
import torch
from lerobot_policy_obact.teacher import CLOSED_FRAMES, CLOSING_FRAMES, PLANNED_SPEED, SLACK_M, answers, virtual_palms

STEP_M = 0.025


def paths(n: int, frames: int = 60) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(n, 1, 3, generator=generator) * 0.3
    velocity = torch.randn(n, 1, 3, generator=generator) * 0.01
    return start + velocity * torch.arange(frames)[:, None]


def searched(path: torch.Tensor, due: int, palm: torch.Tensor, share: float) -> int | None:
    """The first number of frames in which the palm gets near enough to the path at a share of its full speed."""
    for ahead in range(1, len(path) - due):
        if (path[due + ahead] - palm).norm() <= share * STEP_M * ahead + SLACK_M:
            return ahead
    return None


def test_it_meets_the_target_at_the_first_point_in_reach_with_time_to_spare_if_there_is_one():
    path, length = paths(20), torch.full((20,), 60)
    due, palms = torch.randint(0, 30, (20, 4)), torch.randn(20, 4, 3, 3) * 0.2
    told = answers(path, length, due, palms, STEP_M)
    for b, q, m in np.ndindex(20, 4, 3):
        calm, found = (searched(path[b], int(due[b, q]), palms[b, q, m], share) for share in (PLANNED_SPEED, 1.0))
        assert bool(told.reachable[b, q, m]) == (found is not None)
        if found is not None:
            assert int(told.frames[b, q, m]) == (calm or found)
            assert torch.equal(told.meeting[b, q, m], path[b, int(due[b, q]) + (calm or found)])


@pytest.mark.parametrize(("speed_m", "frames"), [(0.0, 29), (0.03, 1)])
def test_out_of_reach_it_goes_where_it_is_the_least_late_and_counts_little(speed_m: float, frames: int):
    path = torch.tensor([5.0, 0, 0]) + torch.arange(40)[:, None] * torch.tensor([speed_m, 0, 0])
    told = answers(path[None], torch.tensor([40]), torch.tensor([[10]]), torch.zeros(1, 1, 1, 3), STEP_M)
    assert not told.reachable.any()
    assert int(told.frames) == frames
    assert float(told.weight) < 0.5


def test_a_hand_that_trails_a_faster_target_within_reach_closes_the_gap():
    path = torch.tensor([0.035, 0, 0]) + torch.arange(40)[:, None] * torch.tensor([1.1 * STEP_M, 0, 0])
    told = answers(path[None], torch.tensor([40]), torch.tensor([[0]]), torch.zeros(1, 1, 1, 3), STEP_M)
    assert not told.reachable.any()
    assert int(told.frames) == 1


def test_fingers_are_closed_before_the_meeting_and_open_long_before():
    path = torch.tensor([[[1.0, 0, 0]]]).expand(1, 100, 3)
    closing = answers(path, torch.tensor([100]), torch.tensor([[0]]), torch.zeros(1, 1, 1, 3), STEP_M).closing(50)
    left = 47 - torch.arange(50)  # 0.985 m at 0.85 of 2.5 cm a frame
    assert (closing[0, 0, 0, left <= CLOSED_FRAMES] == 1).all()
    assert (closing[0, 0, 0, left >= CLOSED_FRAMES + CLOSING_FRAMES] == 0).all()
    assert (closing[0, 0, 0].diff() >= 0).all()


def test_the_first_virtual_palm_is_the_recorded_one_and_the_others_are_near_it_or_its_way():
    torch.manual_seed(0)
    path, length, window = paths(50), torch.full((50,), 60), torch.full((50,), 8)
    due, palm = torch.full((50, 2), 20), torch.randn(50, 2, 3) * 0.1
    palms = virtual_palms(path, length, window, due, palm=palm, step_m=STEP_M)
    assert torch.equal(palms[:, :, 0], palm)
    assert 0.01 < (palms[:, :, 1] - palm).norm(dim=-1).median() < 0.15
    first = answers(path, length, window[:, None], torch.zeros(50, 1, 1, 3), STEP_M).meeting[:, 0]
    share = (12 * STEP_M / first.norm(dim=-1, keepdim=True)).clamp_max(1)  # (50, 1, 1)
    assert (palms[:, :, 2] - share * first).norm(dim=-1).median() < 0.15


@pytest.mark.parametrize("late", [0, 3])
def test_without_slack_it_agrees_with_the_expert(late: int, monkeypatch: pytest.MonkeyPatch):
    from dynahoi_lerobot.core.rules import CONTROL_CLASSES
    from dynahoi_lerobot.experts.intercept import earliest_arrival
    from dynahoi_lerobot.sampling.recipe import Recipe
    from dynahoi_lerobot.sampling.sampler import sample_specs

    monkeypatch.setattr("lerobot_policy_obact.teacher.SLACK_M", 0.0)
    control = CONTROL_CLASSES["late" if late else "standard"]
    for spec in sample_specs(Recipe(control_class=control.name), range(22)):
        path = torch.from_numpy(spec.oracle_path - spec.home_pos_w).float()[None]
        due = spec.window_frames + 2 + late
        told = answers(path, torch.tensor([path.shape[1]]), torch.tensor([[due]]), torch.zeros(1, 1, 1, 3), STEP_M)
        waiting = np.concatenate([spec.home_pos_w, spec.reference_joints])
        arrival = earliest_arrival(waiting, spec.reference_joints, spec.oracle_path[due:], PLANNED_SPEED * 0.5, control)
        missed = arrival == len(spec.oracle_path) - due - 1
        assert missed or abs(int(told.frames) - arrival) <= 1  # single precision decides ties
