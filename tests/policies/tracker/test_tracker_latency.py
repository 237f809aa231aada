"""The intercept head continues what the hand has committed to, from where that leads."""

from __future__ import annotations

import pytest
import torch
from lerobot.configs import NormalizationMode
from lerobot_policy_tracker import TrackerPolicy
from lerobot_policy_tracker.heads.base import Prefix
from lerobot_policy_tracker.heads.intercept import continued, delayed
from lerobot_policy_tracker.reach import Reach, executed
from tracker_helpers import make_policy, make_step, phase_of, randomise

REACH = Reach(palm_step_m=0.025, joint_step_rad=1.0, spare_frames=4, closing_frames=8)
INTERCEPTING = {
    "backbone": "eye",
    "backbone_options": {"channels": 8, "fovea": 8, "embedding": 4},
    "head": "intercept",
    "head_options": {},
    "normalization_mapping": dict.fromkeys(("VISUAL", "STATE", "ENV", "ACTION"), NormalizationMode.IDENTITY),
    "action_frame": "relative",
}


def acting_policy(**changes: object) -> TrackerPolicy:
    return randomise(make_policy(**INTERCEPTING | changes)).eval()


def acting_step(policy: TrackerPolicy) -> dict:
    """A frame of the control phase."""
    return make_step(policy) | {"observation.phase": phase_of(torch.ones(3))}


def committed(step: dict, n: int) -> torch.Tensor:
    """(3, n, 18) actions that go 2 cm a frame along x and close the fingers by 0.1 rad a frame."""
    per_frame = torch.tensor([0.02, 0.0, 0.0] + [0.1] * 15)
    return step["observation.state"][:, None] + per_frame * torch.arange(1, n + 1)[:, None]


def test_a_hand_follows_its_commands_as_far_as_a_frame_allows():
    start, far = torch.zeros(2, 18), torch.zeros(2, 3, 18)
    far[..., 0], far[..., 3] = 0.06, 2.5
    where = executed(start, far, torch.tensor([2, 3]), REACH)
    torch.testing.assert_close(where[:, 0], torch.tensor([0.05, 0.06]))
    torch.testing.assert_close(where[:, 3], torch.tensor([2.0, 2.5]))


def test_each_row_continues_its_own_number_of_actions():
    prefix = Prefix(torch.tensor([[1.0, 2.0], [3.0, 4.0]])[..., None], torch.tensor([2, 1]))
    moves = torch.tensor([[10.0, 11.0, 12.0], [20.0, 21.0, 22.0]])[..., None]
    assert continued(prefix, moves)[..., 0].tolist() == [[1, 2, 10, 11, 12], [3, 20, 21, 22, 22]]


def test_each_row_sees_the_path_later():
    path = torch.arange(4.0)[None, :, None].expand(2, 4, 3)
    assert delayed(path, torch.tensor([0, 2]))[..., 0].tolist() == [[0, 1, 2, 3], [2, 3, 3, 3]]


def test_a_chunk_begins_with_what_is_committed_and_goes_on_from_there_without_a_jump():
    policy = acting_policy()
    step = acting_step(policy)
    actions = committed(step, 5)
    chunk = policy.predict_action_chunk(step, inference_delay=3, prev_chunk_left_over=actions)
    assert chunk.shape == (3, 3 + 8, 18)
    torch.testing.assert_close(chunk[:, :3], actions[:, :3])
    steps = chunk[:, 2:, :3].diff(dim=1).norm(dim=-1)
    assert steps.max() <= 0.025 + 1e-5
    policy.reset()
    unaware = policy.predict_action_chunk(step)
    jump = (unaware[:, 3, :3] - actions[:, 2, :3]).norm(dim=-1)
    assert (jump > 0.03).any(), "a chunk that knows nothing of it begins elsewhere"


def test_actions_that_are_too_few_are_followed_by_the_last_one():
    policy = acting_policy()
    step = acting_step(policy)
    actions = committed(step, 2)
    chunk = policy.predict_action_chunk(step, inference_delay=4, prev_chunk_left_over=actions)
    torch.testing.assert_close(chunk[:, :4], actions[:, [0, 1, 1, 1]])


@pytest.mark.parametrize("given", [True, False])
def test_a_hand_that_does_not_move_meanwhile_stays(given: bool):
    policy = acting_policy()
    step = make_step(policy) | {"observation.phase": phase_of(torch.full((3,), 0.0 if given else 1.0))}
    actions = committed(step, 5) if given else None
    chunk = policy.predict_action_chunk(step, inference_delay=3, prev_chunk_left_over=actions)
    torch.testing.assert_close(chunk[:, :3], step["observation.state"][:, None].expand(-1, 3, -1))


def test_commands_that_take_effect_late_are_a_prefix_as_well():
    # The first command is given at frame 0 and takes effect at frame 3; until then the hand stays.
    policy = acting_policy(latency_frames=3, n_action_steps=1)
    step = acting_step(policy)
    first = policy.select_action(step)
    policy.reset()
    chunk = policy.predict_action_chunk(step, inference_delay=3)
    torch.testing.assert_close(first, chunk[:, 3])
    assert chunk.shape == (3, 8, 18)


def test_it_supports_lerobots_real_time_chunking():
    assert acting_policy().supports_rtc()
    assert acting_policy().accepts_prefix
    assert not make_policy().accepts_prefix
