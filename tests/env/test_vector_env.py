"""The environments keep gymnasium's promises and the benchmark's protocol."""

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import FlattenObservation, RecordEpisodeStatistics
from lerobot_env_dynahoi.task_env import ResultsLog, TaskEnv

from dynahoi_lerobot.core.episode import closure, potential
from dynahoi_lerobot.env import DynahoiEnv, DynahoiVectorEnv
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seed

SMALL = {"image_size": 16}
BLIND = SMALL | {"image_size": 0}


def made(kind: str, **options) -> gym.Env:
    return gym.make(f"dynahoi_lerobot.env:dynahoi/{kind}-v0", **SMALL | options)


@pytest.mark.filterwarnings("ignore")
def test_gymnasiums_checker_finds_nothing() -> None:
    check_env(made("all", render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("kind", MOTIONS.names())
def test_every_kind_of_motion_is_an_id_whose_observations_are_in_its_space(kind: str) -> None:
    env = made(kind, image_size=0)
    for observation in (env.reset(seed=3)[0], env.step(env.action_space.sample())[0]):
        assert env.observation_space.contains(observation)
    spec = env.unwrapped._vector._batch.specs[0]
    assert (spec.motion.name, env.unwrapped.task_description) == (kind, spec.task)


def follow_expert(env: DynahoiVectorEnv, steps: int) -> list[tuple]:
    """Play the demonstrator's commands in every world and return what each step returned."""
    results = []
    for _ in range(steps):
        commands = Intercept().act(env._batch.world_state(env._batch.observe(images=False)))
        results.append(env.step(commands.astype(np.float32)))
    return results


def test_a_catch_ends_the_episode_with_reward_success_and_every_metric() -> None:
    env = DynahoiVectorEnv(2, kind="constant", **BLIND)
    env.reset(seed=[0, 1], options={"lerobot_new_rollout": True})
    _, *told, infos = zip(*follow_expert(env, env._max_episode_steps), strict=True)
    rewards, terminated, truncated = (np.array(one).T for one in told)  # (2, T)
    successes = np.array([info["is_success"] for info in infos]).T
    assert terminated.sum(axis=1).tolist() == [1, 1]
    assert rewards.sum(axis=1).tolist() == [1.0, 1.0]
    assert not truncated.any()
    for world, end in enumerate(terminated.argmax(axis=1)):
        assert successes[world, : end + 1].argmax() == rewards[world].argmax()
        assert infos[end]["S_loc"][world] == infos[end]["S_gra"][world] == 1.0
        assert infos[end]["R_time"][world] > 0
        for name in METRICS.names():
            np.testing.assert_array_equal(infos[end]["_" + name], ~np.isnan(infos[end][name]))


def test_the_single_envs_info_has_the_same_keys_and_types_at_every_step() -> None:
    env = made("constant", image_size=0)
    infos = [env.reset(seed=0)[1]]
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(np.zeros(18, np.float32))
        infos.append(info)
        ended = terminated or truncated
    kinds = {"is_success": bool} | dict.fromkeys(METRICS.names(), float)
    for info in infos:
        assert {name: type(value) for name, value in info.items()} == kinds
    assert not any(any(info.values()) for info in infos[:-1]), "no metric before the end"
    assert np.isnan(infos[-1]["S_gra"]), "does not apply to who never localises"


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_limit_of_steps_truncates_every_episode_and_infos_keep_their_keys(mode) -> None:
    name = "dynahoi_lerobot.env:dynahoi/all-v0"
    env = gym.make_vec(name, 2, max_episode_steps=2, autoreset_mode=mode, image_size=0)
    infos = [env.reset(seed=0)[1]]
    for truncates in (False, True, None):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        infos.append(info)
        assert not terminated.any()
        if truncates is not None:
            assert truncated.tolist() == [truncates] * 2
    wanted = {"is_success", *METRICS.names(), *(f"_{name}" for name in METRICS.names())}
    for info in infos:
        assert {name for name in info if "final_" not in name} == wanted
    last = infos[2].get("final_info", infos[2])
    assert not last["_S_loc"].any(), "what is cut short is not measured"
    with pytest.raises(ValueError, match="max_episode_steps must be at least 1, got 0"):
        DynahoiVectorEnv(1, max_episode_steps=0)


def test_a_hand_that_waits_is_truncated_after_window_l_steps_and_the_outcome_of_the_last() -> None:
    env = DynahoiVectorEnv(1, kind="vertical_circle", **BLIND)
    observation, _ = env.reset(seed=[0])
    spec = env._batch.specs[0]
    hold = observation["agent_pos"]
    *before, last = (
        env.step(hold)[2:4] for _ in range(spec.window_frames + spec.length_frames + 1)
    )
    assert not np.any(before)
    assert last[1][0], "truncated"


def end_and_beginning(mode: str) -> tuple[dict, dict, dict]:
    """Let a hand wait; return the last observation and metrics of its first episode, and the first
    of its next.
    """
    env = DynahoiVectorEnv(
        2, kind="constant", autoreset_mode=mode, environment_state="truth", **SMALL
    )
    hold = env.reset(seed=[0, 1])[0]["agent_pos"]
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(hold)
        ended = terminated[0] or truncated[0]
    if mode == AutoresetMode.SAME_STEP.value:
        assert info["_final_obs"][0]
        info, last, after = info["final_info"], info["final_obs"][0], observation
    elif mode == AutoresetMode.NEXT_STEP.value:
        last = of_world(observation, 0)
        after, reward, terminated, truncated, _ = env.step(hold)
        assert (reward[0], terminated[0], truncated[0]) == (0.0, False, False)
    else:
        last = of_world(observation, 0)
        assert not env.step(hold)[0]["pixels"]["ego"][0].any()
        after, _ = env.reset(options={"reset_mask": np.array([True, False])})
    assert env._batch.specs[0].seed == kind_seed(env.recipe, "constant", 2), (
        "its number plus those of worlds"
    )
    return last, {name: info[name][0] for name in METRICS.names()}, of_world(after, 0)


def of_world(batched: dict, i: int) -> dict:
    return {
        key: of_world(value, i) if isinstance(value, dict) else value[i]
        for key, value in batched.items()
    }


def test_an_autoreset_mode_changes_when_episodes_begin_and_nothing_else() -> None:
    assert DynahoiVectorEnv(1, **BLIND).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP, (
        "by default"
    )
    wanted, *others = (end_and_beginning(mode.value) for mode in AutoresetMode)
    for found in others:
        np.testing.assert_equal(found, wanted)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_gymnasiums_vector_wrappers_understand_every_autoreset_mode(mode: AutoresetMode) -> None:
    env = vector(autoreset_mode=mode, reward="dense", image_size=0)
    if mode != AutoresetMode.SAME_STEP:  # which gymnasium's observation wrappers refuse
        env = FlattenObservation(env)
    env = RecordEpisodeStatistics(env)
    env.reset(seed=0)
    rewards = np.zeros(2)
    ended = np.zeros(2, bool)
    while not ended.any():
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        rewards = rewards + reward
        ended = terminated | truncated
    np.testing.assert_allclose(info["episode"]["r"][ended], rewards[ended])


def test_what_is_no_autoreset_mode_or_mask_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'Never'.* NextStep, SameStep, Disabled"):
        DynahoiVectorEnv(1, autoreset_mode="Never", **BLIND)
    env = DynahoiVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, **BLIND)
    with pytest.raises(ResetNeeded):
        env.reset(options={"reset_mask": np.array([True, False])})
    for mask in (np.ones(3, bool), np.zeros(2, bool), np.ones(2)):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})


@pytest.mark.filterwarnings("ignore")
def test_stable_baselines_accepts_a_flat_observation() -> None:
    from stable_baselines3.common import (
        env_checker as stable_baselines,
    )  # which takes long to import

    options = {"image_size": 0, "environment_state": "truth", "control_mode": "grasp"}
    env = gym.wrappers.FlattenObservation(made("constant", **options))
    assert env.observation_space.shape == (18 + 2 + 13,)
    stable_baselines.check_env(env)


def test_the_terminal_observation_shows_the_last_frame_also_in_one_episode_mode() -> None:
    env = DynahoiVectorEnv(1, kind="constant", **SMALL)
    env.reset(seed=[0], options={"lerobot_new_rollout": True})
    while not (step := follow_expert(env, 1)[0])[2][0]:
        pass
    assert step[0]["pixels"]["ego"][0].std() > 5.0
    frame = env._batch.frame[0]
    after, *_ = env.step(np.zeros((1, 18), np.float32))
    assert env._batch.frame[0] == frame
    assert not after["pixels"]["ego"].any(), "a world that stands still costs no rendering"


def test_seeds_number_the_episodes_of_kind_and_split() -> None:
    env = DynahoiVectorEnv(3, kind="lob", split="test_small", **BLIND)
    env.reset(seed=4)
    first = Recipe(split="test").motion_names.index("lob")
    assert [spec.seed for spec in env._batch.specs] == [first + 22 * n for n in (4, 0, 1)]


def test_the_first_episodes_are_played_over_and_over() -> None:
    env = DynahoiVectorEnv(2, split="train", kind="lob", episodes=3, **BLIND)
    env.reset(seed=4)
    hand = np.zeros(env.action_space.shape, np.float32)
    seeds = set()
    for _ in range(200):
        env.step(hand)
        seeds |= {spec.seed for spec in env._batch.specs}
    assert seeds == {kind_seed(env.recipe, "lob", number) for number in range(3)}
    with pytest.raises(ValueError, match="at least 1, or None for all, got 0"):
        DynahoiVectorEnv(2, episodes=0)


def test_bad_actions_are_refused_and_nothing_moves() -> None:
    env = DynahoiVectorEnv(1, **BLIND)
    env.reset(seed=[0])
    before = env._batch._batch.state.copy()
    for action in (np.zeros((1, 17)), np.full((1, 18), np.nan), np.full((1, 18), "0.5")):
        with pytest.raises(ValueError, match="action"):
            env.step(action)
        np.testing.assert_array_equal(env._batch._batch.state, before)


@pytest.mark.parametrize("capture", ["attach", "contact"])
def test_a_recording_holds_the_dense_reward_of_the_environment(capture: str):
    recording = Recording.of(split="test", capture=capture, image_size=0)
    (episode,) = record(recording, [3])
    env = DynahoiEnv(recipe=recording.recipe, reward="dense")
    env.reset(seed=3)
    rewards = np.array([env.step(action)[1] for action in episode.given_action])
    assert (rewards[: episode.meta.window_frames] == 0).all(), "nothing can be done in the window"
    won = episode.succeeded.argmax()
    assert rewards[won + 1] > 0.9, "of the first step that begins in a frame of success"
    rewards[won + 1] -= 1
    rewards[won] += 1
    np.testing.assert_allclose(rewards[:-1], episode.reward[:-1], atol=1e-5)


def test_closing_further_near_the_target_is_worth_more_until_the_grasp_is_one():
    shares = np.array([0.0, 0.4, 0.8, 0.9, 1.2, 1.5])
    joints = np.tile(shares[:, None], 15)
    closed = closure(joints, np.zeros(15), np.ones(15))
    near = potential(np.full(6, 0.01), closed)
    assert (np.diff(near)[:3] > 0.05).all()
    assert near[3] == near[4] > near[5]
    far = potential(np.full(6, 1.0), closed)
    assert np.ptp(far) < 1e-3 < np.ptp(near), "far away a fist earns nothing"
    assert potential(np.zeros(1), np.ones(1)) == 1.0


OPTIONS: dict[str, Any] = {
    "kind": "lob",
    "image_size": 16,
    "views": ("side",),
    "capture": "contact",
    "salt": "correct horse battery staple",
    "threads": 1,
}
COPIES: list[Callable] = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]


def single(**options: Any) -> DynahoiEnv:
    return DynahoiEnv(**{**OPTIONS, **options})


def vector(**options: Any) -> DynahoiVectorEnv:
    return DynahoiVectorEnv(2, **{**OPTIONS, **options})


ENVS = pytest.mark.parametrize("make", [single, vector])


@ENVS
@pytest.mark.parametrize("copied", COPIES)
def test_a_copy_plays_what_the_original_plays(make: Callable, copied: Callable) -> None:
    env = make(protocol="direct_act", split="val")
    env.reset(seed=1)
    env.step(env.action_space.sample())
    twin = copied(env)
    with pytest.raises(ResetNeeded):
        twin.step(env.action_space.sample())
    action = env.reset(seed=5)[0]["agent_pos"]
    np.testing.assert_equal(env.reset(seed=5), twin.reset(seed=5))
    np.testing.assert_equal(env.step(action), twin.step(action))
    assert (twin.render_mode, twin.observation_space) == (env.render_mode, env.observation_space)


def test_a_copy_of_lerobots_task_reports_to_a_log_of_the_same_folder(tmp_path: Path) -> None:
    env = TaskEnv(
        1, on_episode=ResultsLog(tmp_path, Recipe.of(split="test", image_size=16)), **OPTIONS
    )
    twin = copy.deepcopy(env)
    assert (twin._on_episode._results.folder, twin.kind, twin.num_envs) == (tmp_path, "lob", 1)


@ENVS
def test_a_closed_env_says_so(make: Callable) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    env.close()
    env.close()
    for use in (env.reset, env.render, lambda: env.step(env.action_space.sample())):
        with pytest.raises(ClosedEnvironmentError):
            use()


def test_seeds_are_whole_numbers_below_two_to_the_forty_one_for_each_world() -> None:
    two = vector(image_size=0)
    for seed in (-1, 1.5, 2**40, True):
        for env, given in ((single(image_size=0), seed), (two, [0, seed])):
            with pytest.raises(ValueError, match="a seed must be an integer"):
                env.reset(seed=given)
    for seed in (np.int64(4), [4, 5], np.array([4, 5])):
        two.reset(seed=seed)
        assert two._numbers.tolist() == [4, 5]
    two.reset(seed=[None, 2**40 - 1])
    assert two._numbers[1] == 2**40 - 1
    with pytest.raises(ValueError, match="one seed for each of 2 worlds, got 3"):
        two.reset(seed=[1, 2, 3])


def test_options_are_fields_of_a_recipe_and_unknown_ones_are_refused() -> None:
    env = DynahoiVectorEnv(
        1, recipe=Recipe.of(split="val", image_size=0), control_class="late", views=["side"]
    )
    assert env.recipe == Recipe.of(split="val", image_size=0, control_class="late", views=("side",))
    for make in (DynahoiEnv, DynahoiVectorEnv):
        with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
            make(colour="red")
