"""The dense reward is progress towards the target, and changes nothing else."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from dynahoi_lerobot.env import DynahoiVectorEnv
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.phase import is_acting

SMALL = {"kind": "constant", "image_size": 0, "threads": 1}


def played(env: DynahoiVectorEnv, *, expert: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Play one episode a world; return rewards, whether it acts and distances [m] (T, N) each, and successes (N,)."""
    observation, _ = env.reset(seed=0, options={"lerobot_new_rollout": True})
    batch, rewards, phases, distances = env._batch, [], [], []
    ended, success = np.zeros(env.num_envs, bool), np.zeros(env.num_envs, bool)
    while not ended.all():
        phases.append(is_acting(observation["phase"]))
        distances.append(np.linalg.norm(batch.target_pose[:, :3] - batch.state[:, :3], axis=1))
        command = (
            Intercept().act(batch.world_state(batch.observe(images=False))) if expert else observation["agent_pos"]
        )
        observation, reward, terminated, truncated, info = env.step(command.astype(np.float32))
        rewards.append(np.where(ended, 0.0, reward))
        success |= info["is_success"]
        ended |= terminated | truncated
    distances.append(np.linalg.norm(batch.target_pose[:, :3] - batch.state[:, :3], axis=1))
    return np.array(rewards), np.array(phases), np.array(distances), success


@pytest.mark.parametrize("expert", [True, False])
def test_the_sum_is_how_much_closer_the_palm_came_in_units_of_a_decimetre_and_the_success(expert: bool):
    rewards, phases, distances, success = played(DynahoiVectorEnv(2, reward="dense", **SMALL), expert=expert)
    assert (rewards[~phases] == 0).all(), "nothing can be done in the observation window"
    first = phases.argmax(axis=0)
    for world in range(2):
        came_m = distances[first[world], world] - distances[-1, world]
        assert rewards[:, world].sum() == pytest.approx(came_m / 0.1 + success[world], abs=0.05)
    assert success.tolist() == [expert, expert]


def test_a_sparse_reward_is_the_success_and_both_play_the_same_episode():
    dense = played(DynahoiVectorEnv(2, reward="dense", **SMALL), expert=True)
    sparse = played(DynahoiVectorEnv(2, **SMALL), expert=True)
    assert sparse[0].sum(axis=0).tolist() == [1.0, 1.0]
    np.testing.assert_array_equal(dense[2], sparse[2])


def test_a_copy_has_the_same_reward_and_an_unknown_one_is_refused():
    assert pickle.loads(pickle.dumps(DynahoiVectorEnv(1, reward="dense", **SMALL))).reward == "dense"
    with pytest.raises(ValueError, match="unknown reward 'shaped'; known: sparse, dense"):
        DynahoiVectorEnv(1, reward="shaped", **SMALL)
