"""Positions that are observed, commanded and recorded count from the palm's home; where that is, is not told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.env import DynahoiVectorEnv
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import HAND_DOF, PALM_DOF
from dynahoi_lerobot.motions.straight_line import Constant
from dynahoi_lerobot.rollout.replay import ActionLog, replay
from dynahoi_lerobot.sampling.recipe import Recipe
from tests.world.playing import wait, world

RECIPE = Recipe(split="test", image_size=32)
SHIFT_W = np.array([0.5, -0.25, 0.125])
ROUNDING = 2e-6
"""Of positions up to 3 m in single precision [m]."""


def shifted(spec: EpisodeSpec) -> EpisodeSpec:
    """The episode of a target in straight motion with everything in it elsewhere in the world."""
    assert isinstance(spec.motion, Constant)
    return replace(
        spec,
        motion=replace(spec.motion, meeting=tuple((np.asarray(spec.motion.meeting) + SHIFT_W).tolist())),
        home_pos_w=spec.home_pos_w + SHIFT_W,
        intercept_pos_w=spec.intercept_pos_w + SHIFT_W,
        oracle_path=spec.oracle_path + SHIFT_W,
    )


def test_the_first_observation_is_the_same_wherever_the_home_is(specs: list[EpisodeSpec]):
    batch = world(specs)
    observation, tips = batch.observe(images=False), batch.fingertips()
    assert not observation.state[:, :PALM_DOF].any()
    np.testing.assert_allclose(observation.state, np.tile(observation.state[0], (len(specs), 1)), atol=ROUNDING)
    np.testing.assert_allclose(tips, np.tile(tips[0], (len(specs), 1)), atol=5e-6)


def test_an_episode_elsewhere_looks_the_same_in_numbers(specs: list[EpisodeSpec]):
    here = next(spec for spec in specs if spec.motion.name == "constant")
    one, other = world([here]), world([shifted(here)])
    rng = np.random.default_rng(3)
    while not one.localized[0] and one.frame[0] < here.window_frames + 12:
        command = np.concatenate([rng.uniform(-0.3, 0.3, PALM_DOF), rng.uniform(0, 1, HAND_DOF - PALM_DOF)])[None]
        for batch in (one, other):
            batch.step(command)
        for name in ("state", "commanded", "target_pose", "target_velocity", "palm_distance"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=ROUNDING, err_msg=name)
    np.testing.assert_allclose(other.home_pos_w - one.home_pos_w, SHIFT_W[None], atol=1e-12)


def test_the_action_space_does_not_tell_the_home_and_holds_every_reachable_command(specs: list[EpisodeSpec]):
    env = DynahoiVectorEnv(4, images=False, split="test", image_size=32)
    low, high = env.single_action_space.low, env.single_action_space.high
    np.testing.assert_array_equal(low[:PALM_DOF], -high[:PALM_DOF])
    bounds = []
    for seed in (0, 4):
        env.reset(seed=seed)
        bounds.append((env.single_action_space.low, env.single_action_space.high))
    np.testing.assert_array_equal(bounds[0], bounds[1])
    batch = world(specs[:4], control_class="unlimited")
    wait(batch)
    for side in (-1.0, 1.0):
        for _ in range(60):
            batch.step(np.full((4, HAND_DOF), side * 50.0))
        assert (batch.commanded >= low).all()
        assert (batch.commanded <= high).all()


def test_the_slides_end_where_they_do_in_the_world(specs: list[EpisodeSpec]):
    batch = world(specs[:4], control_class="unlimited")
    wait(batch)
    for _ in range(60):
        batch.step(np.full((4, HAND_DOF), -50.0))
    ends = batch.state[:, :PALM_DOF] + batch.home_pos_w
    np.testing.assert_allclose(ends, np.tile(batch.servo.low[:PALM_DOF], (4, 1)), atol=0.01)


def test_an_episode_keeps_its_home_apart(expert_episodes: list[Episode], specs: list[EpisodeSpec]):
    for episode, spec in zip(expert_episodes, specs, strict=True):
        np.testing.assert_array_equal(episode.home_position, spec.home_pos_w)  # exactly, in single precision
        np.testing.assert_allclose(
            episode.intercept_position + episode.home_position, spec.intercept_pos_w, atol=ROUNDING
        )
        assert not episode.state[0, :PALM_DOF].any()
        np.testing.assert_allclose(
            episode.target_pose[: spec.window_frames, :3] + episode.home_position,
            spec.oracle_path[: spec.window_frames],
            atol=0.01 if spec.motion.category in ("inclined_rolling", "impact_response") else ROUNDING,
        )


@pytest.mark.parametrize("control_class", ["standard", "late"])
def test_stored_actions_replay_to_the_bit(control_class: str, specs: list[EpisodeSpec]):
    """Over whole episodes with commands beyond every limit: those of the slides lie elsewhere in each home frame."""
    recipe = replace(RECIPE, control_class=control_class)
    for spec in specs[2:20:6]:
        rng = np.random.default_rng(spec.seed)
        commands = rng.normal(0, [1.5] * PALM_DOF + [1.0] * (HAND_DOF - PALM_DOF), (40, HAND_DOF))
        (first,) = replay(recipe, [ActionLog(spec.seed, np.repeat(commands, 2, axis=0)[:60])], images=False)
        (again,) = replay(recipe, [ActionLog(spec.seed, first.action)], images=False)
        for name in ("state", "action", "fingertips", "target_pose"):
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name), err_msg=name)


def test_the_batch_says_where_its_homes_are(specs: list[EpisodeSpec]):
    batch = world(specs[:3])
    np.testing.assert_array_equal(batch.home_pos_w, [spec.home_pos_w for spec in specs[:3]])
