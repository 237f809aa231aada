"""The environments can be copied and closed, and refuse what they cannot play with one sentence."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from lerobot_env_dynahoi.task_env import ResultsLog, TaskEnv

from dynahoi_lerobot.env import DynahoiEnv, DynahoiVectorEnv, register_envs
from dynahoi_lerobot.sampling.recipe import Recipe

OPTIONS: dict[str, Any] = {"kind": "lob", "image_size": 16, "views": ("side",), "capture": "contact", "threads": 1}
COPIES: list[Callable] = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]


def single(**options: Any) -> DynahoiEnv:
    return DynahoiEnv(**{**OPTIONS, **options})


def vector(**options: Any) -> DynahoiVectorEnv:
    return DynahoiVectorEnv(2, **{**OPTIONS, **options})


ENVS = pytest.mark.parametrize("make", [single, vector])


def assert_same(one: dict, other: dict) -> None:
    assert one.keys() == other.keys()
    for key, value in one.items():
        if isinstance(value, dict):
            assert_same(value, other[key])
        else:
            np.testing.assert_array_equal(value, other[key], key)


@ENVS
@pytest.mark.parametrize("copied", COPIES)
def test_a_copy_plays_what_the_original_plays(make: Callable, copied: Callable) -> None:
    env = make(protocol="direct_act", split="val")
    env.reset(seed=1)
    env.step(env.action_space.sample())
    twin = copied(env)
    with pytest.raises(ResetNeeded, match="call reset first"):
        twin.step(env.action_space.sample())
    action = env.reset(seed=5)[0]["agent_pos"]
    assert_same(env.reset(seed=5)[0], twin.reset(seed=5)[0])
    for one, other in zip(env.step(action), twin.step(action), strict=True):
        assert_same({"": one}, {"": other})
    assert (twin.render_mode, twin.observation_space) == (env.render_mode, env.observation_space)


@pytest.mark.parametrize("copied", COPIES)
def test_a_copy_of_a_made_env_keeps_its_id_and_its_wrappers(copied: Callable) -> None:
    register_envs()
    env = gym.make("dynahoi/ramp-v0", image_size=0)
    twin = copied(env)
    assert twin.spec.id == env.spec.id == "dynahoi/ramp-v0"
    assert_same(env.reset(seed=2)[0], twin.reset(seed=2)[0])


def test_a_copy_of_lerobots_task_reports_to_a_log_of_the_same_folder(tmp_path: Path) -> None:
    env = TaskEnv(ResultsLog(tmp_path, "test", Recipe(split="test", image_size=16)), 1, **OPTIONS)
    twin = copy.deepcopy(env)
    assert (twin._log.folder, twin.kind, twin.num_envs) == (tmp_path, "lob", 1)
    assert twin._on_episode == twin._log.add


@ENVS
def test_a_closed_env_says_so(make: Callable) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    env.close()
    env.close()
    for use in (env.reset, env.render, lambda: env.step(env.action_space.sample())):
        with pytest.raises(ClosedEnvironmentError, match="this environment was closed; make a new one"):
            use()


@ENVS
def test_the_first_call_is_reset(make: Callable) -> None:
    env = make(render_mode="rgb_array")
    for use in (env.render, lambda: env.step(env.action_space.sample())):
        with pytest.raises(ResetNeeded, match="call reset first"):
            use()


@ENVS
@pytest.mark.parametrize("mode", ["human", "ansi"])
def test_unknown_render_modes_are_refused(make: Callable, mode: str) -> None:
    with pytest.raises(ValueError, match=f"unknown render mode '{mode}'; known: rgb_array, or None"):
        make(render_mode=mode)


@ENVS
@pytest.mark.parametrize("seed", [-1, 1.5, "3", 2**40, True, np.float64(2.0)])
def test_seeds_are_whole_numbers_below_two_to_the_forty(make: Callable, seed: Any) -> None:
    env = make(image_size=0)
    with pytest.raises(ValueError, match=r"a seed must be an integer from 0 to 2\^40 - 1, got"):
        env.reset(seed=seed)
    with pytest.raises(ValueError, match=r"a seed must be an integer from 0 to 2\^40 - 1, got"):
        vector(image_size=0).reset(seed=[0, seed])


def test_a_batch_takes_one_seed_for_each_world_of_any_kind_of_integer() -> None:
    env = vector(image_size=0)
    for seed in (4, np.int64(4), [4, 5], np.array([4, 5]), (4, 5)):
        env.reset(seed=seed)
        assert env._numbers.tolist() == [4, 5]
    env.reset(seed=[None, 2**40 - 1])
    assert env._numbers[1] == 2**40 - 1
    with pytest.raises(ValueError, match="one seed for each of 2 worlds, got 3"):
        env.reset(seed=[1, 2, 3])
