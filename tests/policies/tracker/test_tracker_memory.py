"""What a decision remembers: the observation window for the whole episode, the last frames, or both."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from lerobot_policy_tracker.configuration_tracker import MEMORIES, MEMORY_MODULES
from lerobot_policy_tracker.decisions import window_decisions
from lerobot_policy_tracker.modeling_tracker import TrackerPolicy
from lerobot_policy_tracker.observation import Observation
from tracker_helpers import make_policy, make_step, randomise

N_FRAMES, N_WATCHED = 24, 6


def remembering(memory: str, **changes: object) -> TrackerPolicy:
    options = {"n_obs_frames": 2, "obs_stride": 1, "n_window_frames": 3, "window_reach": 20, **changes}
    return randomise(make_policy(memory=memory, image_size=16, ema_decay=0.0, **options)).eval()


def episode(policy: TrackerPolicy) -> list[dict]:
    """Steps of two environments; LeRobot normalises the phase."""
    return [make_step(policy, n=2, seed=t, phase=1.0 if t >= N_WATCHED else -1.0) for t in range(N_FRAMES)]


def last_action(policy: TrackerPolicy, steps: list[dict]) -> torch.Tensor:
    """Play all steps with one action a chunk; return the last action."""
    policy.config.n_action_steps = 1
    policy.reset()
    return [policy.select_action(step) for step in steps][-1]


@pytest.mark.slow
@pytest.mark.parametrize("memory", MEMORIES)
def test_a_decision_sees_the_frames_of_its_memory_and_no_others(memory: str):
    policy = remembering(memory)
    steps, changed = episode(policy), set()
    before = last_action(policy, steps)
    for t in range(N_FRAMES):
        other = {**steps[t], "observation.state": steps[t]["observation.state"] + 1.0}
        after = last_action(policy, [*steps[:t], other, *steps[t + 1 :]])
        changed |= {t} if not torch.equal(before, after) else set()
    seen = {t - 23 for t in changed}
    wanted = {-offset for offset in [0, *(offset for offset in _offsets(policy) if _visible(offset, memory))]}
    assert seen == wanted


def _offsets(policy: TrackerPolicy) -> list[int]:
    return [-back for back in policy.config.windows.lookback if back]


def _visible(offset: int, memory: str) -> bool:
    recent, watched = offset <= 2, N_FRAMES - 1 - offset < N_WATCHED
    return {"recent": recent, "window": watched, "both": recent or watched, "episode": True}[memory]


def test_memories_differ_in_what_they_reach():
    recent, window, both = (remembering(memory).config.windows.lookback for memory in ("recent", "window", "both"))
    assert recent == [-2, -1, 0]
    assert min(window) == min(both) == -20
    assert set(recent) < set(both)


@pytest.mark.parametrize("module", MEMORY_MODULES)
def test_whole_episodes_give_the_conditions_of_acting_frame_by_frame(module: str):
    """Updates see an episode at once, acting one frame after the other; both must see the same."""
    reach = {"n_obs_frames": 30} if module == "gru" else {}
    policy = remembering("both", memory_module=module, **reach)
    model, config, steps = policy.model, policy.config, episode(policy)
    frames = [model.encode(Observation.from_batch(step, config)) for step in steps]
    policy.reset()
    acting = []
    for frame in frames:
        policy.planner.history.append(frame)
        window = policy.planner.history.window(model.encode)
        alone = window_decisions(window, [list(range(window.keep.shape[1]))], config)
        acting.append(model.conditions(window, alone).tokens)
    whole = type(frames[0]).concatenate(frames)
    index = torch.arange(N_FRAMES)[:, None] + torch.tensor(config.windows.lookback)
    at_once = model.conditions(whole, window_decisions(whole, index, config)).tokens.unflatten(0, (2, N_FRAMES))
    torch.testing.assert_close(at_once, torch.stack(acting, dim=1), rtol=1e-3, atol=1e-3)


def test_a_frame_that_is_not_watched_is_hidden_beyond_the_recent_ones():
    policy = remembering("both")
    frames = [policy.model.encode(Observation.from_batch(step, policy.config)) for step in episode(policy)]
    whole = type(frames[0]).concatenate(frames)
    index = [[N_FRAMES - 1 + back for back in policy.config.windows.lookback]]
    some = window_decisions(whole, index, policy.config).keep.sum()
    more = window_decisions(replace(whole, watching=torch.ones_like(whole.watching)), index, policy.config).keep.sum()
    assert some < more
