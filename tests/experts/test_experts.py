"""The demonstrator solves the benchmark; the floor does not; between them lies a straight extrapolation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.experts.intercept import RETRY_DELAY_FRAMES, plan_intercept
from dynahoi_lerobot.foundation.conventions import LOCALIZATION_RADIUS_M
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.sampling.recipe import Recipe


def mean(episodes: list[Episode], metric: str) -> float:
    values = [value for value in (measure(episode)[metric] for episode in episodes) if value is not None]
    return float(np.mean(values))


def play_all(name: str, specs: list[EpisodeSpec]) -> list[Episode]:
    return list(evaluate(make_batch(Recipe(image_size=32), 22, threads=1), EXPERTS[name](), specs))


def test_the_expert_catches_everything_at_the_first_attempt(expert_episodes: list[Episode]):
    assert len(expert_episodes) == 44
    assert mean(expert_episodes, "S_loc") == 1.0
    assert mean(expert_episodes, "S_gra") == 1.0
    assert all(episode.success and episode.stage == "captured" for episode in expert_episodes)
    assert {episode.meta.attempts for episode in expert_episodes} == {1}


def test_the_expert_plans_each_episode_anew(specs: list[EpisodeSpec]):
    """Episodes come and go, and later ones may lie where earlier ones lay in memory."""
    batch, busy = make_batch(Recipe(image_size=32), 1, threads=1), EXPERTS["intercept"]()
    for spec in specs[:22]:
        batch.reset([0], [replace(spec)])
        while not batch.acting.all():
            batch.step(batch.executed)
        seen = batch.world_state(batch.observe(images=False))
        np.testing.assert_array_equal(busy.act(seen), EXPERTS["intercept"]().act(seen))
        batch.specs[0] = seen = None


def test_the_expert_is_straight_smooth_and_early(expert_episodes: list[Episode]):
    assert mean(expert_episodes, "Q_line") >= 0.98
    assert mean(expert_episodes, "Q_smooth") >= 0.98
    assert mean(expert_episodes, "R_time") >= 0.5


def test_the_expert_arrives_with_the_target(expert_episodes: list[Episode], specs: list[EpisodeSpec]):
    """It localises at the intercept or, as both approach, up to a few frames before; never later."""
    for episode, spec in zip(expert_episodes, specs, strict=True):
        assert episode.first_localized is not None
        assert episode.first_localized <= spec.intercept_frame + 1
        caught = episode.palm_pos_w[episode.first_localized]
        assert np.linalg.norm(caught - spec.intercept_pos_w) < LOCALIZATION_RADIUS_M + 0.1


def test_evaluated_episodes_are_consistent_records(expert_episodes: list[Episode], specs: list[EpisodeSpec]):
    for episode, spec in zip(expert_episodes, specs, strict=True):
        frames = len(episode)
        assert spec.window_frames < frames <= spec.window_frames + spec.length_frames
        assert (episode.phase[:, 0] == (np.arange(frames) >= spec.window_frames)).all()
        assert not episode.localized[: spec.window_frames].any()
        assert (np.diff(episode.localized.astype(int)) >= 0).all()
        for name in ("state", "fingertips", "action", "target_pose", "target_velocity"):
            assert getattr(episode, name).dtype == np.float32
            assert np.isfinite(getattr(episode, name)).all(), name
        assert episode.images == {}
        # what was commanded at a frame is where the hand is at the next, to a millimetre and a degree
        assert np.abs(episode.action[:-1, :3] - episode.state[1:, :3]).max() < 1e-3
        assert np.abs(episode.action[:-1, 3:] - episode.state[1:, 3:]).max() < 0.02


def test_a_hand_that_never_moves_catches_little(specs: list[EpisodeSpec]):
    episodes = play_all("hold", specs)
    assert mean(episodes, "S_loc") < 0.15
    assert mean(episodes, "S_joint") == 0.0
    for episode in episodes:
        assert np.abs(episode.palm_pos_w - episode.palm_pos_w[0]).max() < 1e-3


def test_knowing_the_velocity_is_worth_less_than_knowing_the_motion(specs: list[EpisodeSpec]):
    assert 0.15 < mean(play_all("constant_velocity", specs[:22]), "S_joint") < 0.95


@pytest.mark.parametrize("name", EXPERTS.names())
def test_every_expert_is_deterministic_and_commands_every_joint(name: str, specs: list[EpisodeSpec]):
    batch = make_batch(Recipe(image_size=32), 4, threads=1)
    batch.reset(range(3), specs[:3])
    for _ in range(specs[0].window_frames + 3):
        world = batch.world_state(batch.observe(images=False))
        commands = EXPERTS[name]().act(world)
        np.testing.assert_array_equal(commands, EXPERTS[name]().act(world))
        assert commands.shape == (4, 18)
        assert np.isfinite(commands).all()
        batch.step(commands[:3], np.arange(3))


def test_retries_aim_later(specs: list[EpisodeSpec]):
    for spec in specs:
        plans = [plan_intercept(spec, attempt) for attempt in (1, 2, 3, 4)]
        last = spec.window_frames + spec.length_frames - 1
        expected = [min(spec.intercept_frame + k * RETRY_DELAY_FRAMES, last) for k in range(4)]
        assert [plan.arrival_frame for plan in plans] == expected
        for plan in plans:
            np.testing.assert_array_equal(plan.goal_pos_w, spec.oracle_path[plan.arrival_frame])


def test_a_hand_that_strayed_goes_straight_on_and_arrives_in_time(specs: list[EpisodeSpec]):
    spec = specs[0]
    reach = plan_intercept(spec)
    palm = spec.home_pos_w + [0.03, -0.05, 0.02]
    start, steps = spec.window_frames, []
    for frame in range(start, spec.intercept_frame):
        command = reach.command(frame, palm)[:3]
        steps.append(command - palm)
        palm = command
    np.testing.assert_allclose(palm, spec.intercept_pos_w, atol=1e-12)
    np.testing.assert_allclose(steps, np.tile(steps[0], (len(steps), 1)), atol=1e-12)
    np.testing.assert_array_equal(reach.command(spec.intercept_frame + 3, palm)[:3], spec.intercept_pos_w)
