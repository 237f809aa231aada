"""What reinforcement learning needs: actions from -1 to 1, and Stable-Baselines3's worlds."""

import gymnasium as gym
import numpy as np
import pytest

from dynahoi_lerobot.env.unit_actions import unit_actions

ENV = "dynahoi_lerobot.env:dynahoi/constant-v0"
OPTIONS = {"image_size": 0, "environment_state": "truth", "reward": "dense"}


@pytest.mark.parametrize(("control_class", "step_m"), [("standard", 0.025), ("unlimited", 0.1)])
def test_a_unit_action_moves_the_palm_by_what_it_can_in_a_step(control_class, step_m) -> None:
    options = OPTIONS | {"control_mode": "grasp", "protocol": "direct_act"}
    one = unit_actions(gym.make(ENV, control_class=control_class, **options))
    many = unit_actions(gym.make_vec(ENV, num_envs=2, control_class=control_class, **options))
    assert (one.action_space.low == -1).all()
    assert many.single_action_space == one.action_space
    action = np.array([1, 0, 0, 1], np.float32)
    for env, actions, worlds in (
        (one, action, one.unwrapped._vector),
        (many, np.tile(action, (2, 1)), many.unwrapped),
    ):
        env.reset(seed=0)
        env.step(actions)
        given = worlds._batch.given[0]
        _, closed = worlds._batch.commands._open_and_closed
        assert given[0] == pytest.approx(step_m, abs=1e-3)
        reached = np.minimum(closed, 20 * 0.05)  # by joints of 20 rad/s
        np.testing.assert_allclose(given[3:], reached, atol=1e-5)


def test_unit_actions_need_the_control_mode_grasp() -> None:
    with pytest.raises(ValueError, match="control_mode 'grasp', got 'joints'"):
        unit_actions(gym.make(ENV, **OPTIONS))


def vector(**options):
    made = {"control_mode": "grasp", "autoreset_mode": "SameStep", "max_episode_steps": 3}
    return gym.make_vec(ENV, num_envs=2, **OPTIONS | made | options)


def test_worlds_learn_with_stable_baselines() -> None:
    from stable_baselines3 import PPO  # which takes long to import

    from dynahoi_lerobot.env.stable_baselines import Worlds

    worlds = Worlds(unit_actions(vector()))
    model = PPO("MlpPolicy", worlds, n_steps=4, batch_size=8, n_epochs=1, device="cpu").learn(8)
    assert model.num_timesteps == 8


def test_worlds_give_the_last_observation_of_an_episode_and_say_how_it_ended() -> None:
    from dynahoi_lerobot.env.stable_baselines import Worlds

    env = Worlds(vector())
    twin = vector(autoreset_mode="Disabled")
    env.seed(5)
    first = env.reset()
    seen = twin.reset(seed=5)[0]
    keys = list(twin.single_observation_space.spaces)
    np.testing.assert_array_equal(first, np.concatenate([seen[key] for key in keys], axis=-1))
    still = np.zeros((2, 4), np.float32)
    for _ in range(3):
        _, _, ended, infos = env.step(still)
        seen = twin.step(still)[0]
    assert ended.all()
    last = np.concatenate([seen[key] for key in keys], axis=-1)
    for info, wanted in zip(infos, last, strict=True):
        np.testing.assert_array_equal(info["terminal_observation"], wanted)
        assert info["TimeLimit.truncated"]


@pytest.mark.parametrize(
    ("options", "named"),
    [({"autoreset_mode": "NextStep"}, "NextStep"), ({"image_size": 16}, "image_size=0")],
)
def test_worlds_refuse_what_stable_baselines_cannot_use(options: dict, named: str) -> None:
    from dynahoi_lerobot.env.stable_baselines import Worlds

    with pytest.raises(ValueError, match=named):
        Worlds(vector(**options))
