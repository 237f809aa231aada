"""Acting: history, chunks, replanning, reproducibility, real-time chunking."""

from __future__ import annotations

import pytest
import torch
from lerobot.policies.rtc import RTCConfig
from lerobot_policy_tracker import TrackerPolicy
from tracker_helpers import PUSH_FEATURES, make_batch, make_policy, make_step, randomise

N_OBS, STRIDE, N_EXECUTED = 2, 2, 4


def acting_policy(**changes: object) -> TrackerPolicy:
    return randomise(make_policy(n_obs_frames=N_OBS, obs_stride=STRIDE, **changes)).eval()


def run(policy: TrackerPolicy, steps: list[dict]) -> torch.Tensor:
    policy.reset()
    return torch.stack([policy.select_action(step) for step in steps], dim=1)  # (B, T, A)


def count_plans(policy: TrackerPolicy) -> list[int]:
    """Return a list that grows by the number of rows of every plan."""
    plans: list[int] = []
    plan = policy.planner.plan
    policy.planner.plan = lambda model, window, *args, **kwargs: (
        plans.append(len(window.keep)) or plan(model, window, *args, **kwargs)
    )
    return plans


def rows(step: dict, index: list[int]) -> dict:
    return {key: value[index] if torch.is_tensor(value) else [value[i] for i in index] for key, value in step.items()}


def test_history_in_the_loop_equals_the_window_of_a_dataset() -> None:
    policy = acting_policy(n_action_steps=1)
    steps = [make_step(policy, seed=seed) for seed in range(6)]
    noise = torch.randn(3, 8, 18, generator=torch.Generator().manual_seed(3))
    policy.reset()
    in_the_loop = [policy.select_action(step, noise=noise) for step in steps][-1]
    window = {key: torch.stack([steps[i][key] for i in (1, 3, 5)], 1) for key in policy.config.input_features}
    from_dataset = policy.predict_action_chunk(window | {"task": steps[0]["task"]}, noise=noise)[:, 0]
    torch.testing.assert_close(in_the_loop, from_dataset)


def test_before_the_first_frame_there_is_padding() -> None:
    policy = acting_policy()
    step, noise = make_step(policy), torch.randn(3, 8, 18, generator=torch.Generator().manual_seed(3))
    batch = {key: torch.stack([step[key]] * 3, 1) for key in policy.config.input_features} | {"task": step["task"]}
    batch["observation.state_is_pad"] = torch.tensor([[True, True, False]] * 3)
    policy.reset()
    chunks = policy.predict_action_chunk(step, noise), policy.predict_action_chunk(batch, noise)
    torch.testing.assert_close(*chunks, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("n_action_steps", "n_steps", "n_encoded"), [(1, 6, 6), (4, 5, 3)])
def test_acting_encodes_once_every_frame_that_a_decision_sees(
    n_action_steps: int, n_steps: int, n_encoded: int
) -> None:
    """Decisions at frames 0 and 4 see frames 0, 2 and 4."""
    policy = acting_policy(n_action_steps=n_action_steps)
    seen: list[int] = []
    backbone = policy._active_model.backbone
    backbone.register_forward_hook(lambda _, inputs, __: seen.append(len(inputs[0])))
    run(policy, [make_step(policy, seed=t) for t in range(n_steps)])
    n_cameras = len(policy.config.image_features)
    assert seen == [3 * n_cameras] * n_encoded


@pytest.mark.parametrize("late", [0, 3])
def test_a_chunk_is_executed_in_order_without_what_is_past_and_then_replanned(late: int) -> None:
    policy = acting_policy(latency_frames=late)
    plans = count_plans(policy)
    step = make_step(policy)
    actions = run(policy, [step] * 2 * N_EXECUTED)
    policy.reset()
    chunk = policy.predict_action_chunk(step)
    assert plans == [3, 3, 3]
    torch.testing.assert_close(actions[:, :N_EXECUTED], chunk[:, late : late + N_EXECUTED])


def test_a_rising_phase_replans_only_its_own_rows() -> None:
    policy = acting_policy()
    plans = count_plans(policy)
    phases = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]]
    run(policy, [make_step(policy, seed=t, phase=phase) for t, phase in enumerate(phases)])
    assert plans == [3, 1, 1, 1, 1]  # all; row 1 rises; row 2 rises; row 0 and then row 1 run out; a fall does nothing


def test_no_phase_in_the_dataset_means_no_replanning() -> None:
    policy = randomise(make_policy(PUSH_FEATURES))
    plans = count_plans(policy)
    run(policy, [make_step(policy, seed=t) for t in range(N_EXECUTED)])
    assert plans == [3]


def test_a_row_does_not_depend_on_its_neighbours() -> None:
    policy = acting_policy()
    phases = [[float(t >= 2), float(t >= 3), float(t >= 5)] for t in range(9)]
    steps = [make_step(policy, seed=t, phase=phase) for t, phase in enumerate(phases)]
    together = run(policy, steps)
    alone = run(policy, [rows(step, [1]) for step in steps])
    torch.testing.assert_close(together[1:2], alone, rtol=1e-4, atol=1e-4)


def test_acting_repeats_after_reset_and_with_it_the_noise() -> None:
    policy = acting_policy()
    steps = [make_step(policy, seed=t) for t in range(2 * N_EXECUTED)]
    first = run(policy, steps)
    torch.manual_seed(77)
    torch.testing.assert_close(first, run(policy, steps), rtol=0, atol=0)
    policy.config.noise_seed = 1
    assert (first - run(policy, steps)).abs().max() > 1e-3
    policy.config.noise_seed = None
    assert (run(policy, steps) - run(policy, steps)).abs().max() > 1e-3


def test_without_spread_every_seed_gives_the_same_chunk() -> None:
    policy = acting_policy()
    steps = [make_step(policy, seed=t) for t in range(N_EXECUTED)]
    policy.config.noise_scale = 0.0
    first = run(policy, steps)
    policy.config.noise_seed = None
    torch.testing.assert_close(first, run(policy, steps), rtol=0, atol=0)
    policy.config.noise_scale = 1.0
    assert (first - run(policy, steps)).abs().max() > 1e-3


def test_reset_forgets() -> None:
    policy = acting_policy()
    step = make_step(policy, seed=5)
    fresh = run(policy, [step])
    run(policy, [make_step(policy, seed=t) for t in range(6)])
    torch.testing.assert_close(run(policy, [step]), fresh, rtol=0, atol=0)


def test_a_changed_batch_size_asks_for_reset() -> None:
    policy = acting_policy()
    policy.select_action(make_step(policy, n=3))
    with pytest.raises(ValueError, match="from 3 to 2 environments: call policy"):
        policy.select_action(make_step(policy, n=2))


def test_a_wrong_number_of_frames_is_named() -> None:
    policy = acting_policy()
    batch = make_batch(policy)
    short = {key: value[:, :2] if key.startswith("observation.") else value for key, value in batch.items()}
    with pytest.raises(ValueError, match="has 2 frames per sample, but must have 1 or 3"):
        policy.predict_action_chunk(short)


# -- real-time chunking --------------------------------------------------------------------------------------------


def guided_policy(**changes: object) -> TrackerPolicy:
    return acting_policy(rtc_config=RTCConfig(execution_horizon=8, max_guidance_weight=10.0), **changes)


def test_guidance_draws_the_start_of_a_chunk_to_the_old_one() -> None:
    policy = guided_policy(head_options={"n_layers": 1, "n_steps": 10})
    assert policy.supports_rtc()
    step = make_step(policy)
    policy.reset()
    free = policy.predict_action_chunk(step)
    leftover = free + 1.0
    policy.reset()
    guided = policy.predict_action_chunk(step, inference_delay=3, prev_chunk_left_over=leftover)
    before = (free - leftover)[:, :3].abs().mean()
    after = (guided - leftover)[:, :3].abs().mean()
    assert after < 0.3 * before


@pytest.mark.parametrize("frame", ["absolute", "relative"])
def test_an_old_chunk_equal_to_the_free_one_changes_little(frame: str) -> None:
    policy = guided_policy(action_frame=frame, head_options={"n_layers": 1, "n_steps": 50})
    policy.frame.set_stats("state", (torch.ones(18), torch.full((18,), 500.0)))  # far away: frames must not be mixed
    step = make_step(policy)
    policy.reset()
    free = policy.predict_action_chunk(step)
    policy.reset()
    guided = policy.predict_action_chunk(step, inference_delay=8, prev_chunk_left_over=free)
    scale = policy.frame.to_model(free, step["observation.state"]).abs().mean()
    assert (guided - free).abs().mean() < 0.2 * scale


def test_guidance_follows_lerobots_formula_with_time_reversed() -> None:
    from lerobot.policies.rtc import RTCProcessor
    from lerobot_policy_tracker.rtc import rtc_guide

    processor = RTCProcessor(RTCConfig(execution_horizon=4, max_guidance_weight=5.0))
    x, old, data = (torch.randn(2, 4, 3, generator=torch.Generator().manual_seed(i)) for i in range(3))
    t = 0.5
    velocity = (data - x) / (1 - t)  # the straight path to `data`: following it from t reaches `data` at 1
    guide = rtc_guide(processor, old, inference_delay=4)
    guided = guide(x, t, lambda _: velocity)
    # At t = 0.5 the guidance weight is (1-t)/t * (t^2 + (1-t)^2) / (1-t)^2 = 2, and every weight is 1.
    torch.testing.assert_close(guided, velocity + 2.0 * (old - data))


def test_without_an_old_chunk_guidance_does_nothing() -> None:
    policy, plain = guided_policy(), acting_policy()
    step = make_step(policy)
    torch.testing.assert_close(policy.predict_action_chunk(step, inference_delay=2), plain.predict_action_chunk(step))


def test_guidance_works_with_a_head_that_pads_actions() -> None:
    sizes = {"n_layers": 2, "n_heads": 2, "head_dim": 12, "hidden_dim": 16, "memory_dim": 16, "n_adapter_layers": 1}
    policy = guided_policy(head="gr00t_n15", head_options=sizes | {"n_adapter_heads": 2, "n_future_tokens": 2})
    step = make_step(policy)
    policy.reset()
    free = policy.predict_action_chunk(step)
    policy.reset()
    guided = policy.predict_action_chunk(step, inference_delay=3, prev_chunk_left_over=free[:, 2:] + 1.0)
    assert guided.shape == (3, 8, 18)
    wanted = free[:, 2:5] + 1.0
    assert (guided[:, :3] - wanted).abs().mean() < (free[:, :3] - wanted).abs().mean()


def test_the_diffusion_head_declines_guidance() -> None:
    assert not make_policy(head="diffusion").supports_rtc()


def test_frames_that_are_noted_count_like_frames_that_are_acted_on() -> None:
    policy = acting_policy()
    steps = [make_step(policy, seed=seed) for seed in range(5)]
    noise = torch.randn(3, 8, 18, generator=torch.Generator().manual_seed(3))
    policy.reset()
    for step in steps[:-1]:
        policy.observe(step)
    noted = policy.predict_action_chunk(steps[-1], noise=noise)
    window = {key: torch.stack([steps[i][key] for i in (0, 2, 4)], 1) for key in policy.config.input_features}
    torch.testing.assert_close(noted, policy.predict_action_chunk(window | {"task": steps[0]["task"]}, noise=noise))
