"""The environments keep gymnasium's promises and the benchmark's protocol."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from dynahoi_lerobot.env import DynahoiEnv, DynahoiVectorEnv, register_envs
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_spec
from dynahoi_lerobot.sampling.splits import kind_seed
from dynahoi_lerobot.world.batch import WorldBatch

SMALL = {"image_size": 16}
BLIND = SMALL | {"image_size": 0}


def made(kind: str, **options) -> gym.Env:
    register_envs()
    split = "ood_motion" if kind in BENCHMARK.splits["ood_motion"].motions else "test"
    return gym.make(f"dynahoi/{kind}-v0", **{"split": split, **SMALL, **options})


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
    results = follow_expert(env, env._max_episode_steps)
    terminated = np.stack([r[2] for r in results])
    assert terminated.sum(axis=0).tolist() == [1, 1]
    for world in range(2):
        step = int(terminated[:, world].argmax())
        _, reward, _, truncated, info = results[step]
        assert (reward[world], truncated[world], info["is_success"][world]) == (1.0, False, True)
        assert {name for name in METRICS.names() if not np.isnan(info[name][world])} >= {"S_loc", "S_gra", "R_time"}
        assert info["S_loc"][world] == info["S_gra"][world] == 1.0
        assert sum(r[1][world] for r in results) == 1.0


def test_a_hand_that_waits_is_truncated_after_window_l_steps_and_the_outcome_of_the_last() -> None:
    env = DynahoiVectorEnv(1, kind="vertical_circle", **BLIND)
    observation, _ = env.reset(seed=[0])
    spec = env._batch.specs[0]
    assert spec is not None
    hold = observation["agent_pos"]
    flags = [env.step(hold)[2:4] for _ in range(spec.window_frames + spec.length_frames + 1)]
    assert [bool(t or u) for (t, u) in [(f[0][0], f[1][0]) for f in flags]].index(True) == len(flags) - 1
    assert flags[-1][1][0]


def test_autoreset_happens_on_the_next_step_and_ignores_its_action() -> None:
    env = DynahoiVectorEnv(1, kind="constant", **BLIND)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env.reset(seed=[0])
    first = env._batch.specs[0]
    while not (results := follow_expert(env, 1)[0])[2][0]:
        pass
    assert env._batch.specs[0] is first, "the terminal observation still belongs to the episode that ended"
    observation, reward, terminated, truncated, _ = env.step(np.zeros((1, 18), np.float32))
    fresh = env._batch.specs[0]
    assert fresh is not None
    assert fresh is not first
    assert (reward[0], terminated[0], truncated[0]) == (0.0, False, False)
    np.testing.assert_allclose(observation["agent_pos"][0, :3], 0.0, atol=1e-6)
    del results


def test_one_episode_mode_freezes_finished_worlds() -> None:
    env = DynahoiVectorEnv(1, kind="constant", **BLIND)
    env.reset(seed=[0], options={"lerobot_new_rollout": True})
    while not follow_expert(env, 1)[0][2][0]:
        pass
    frame = env._batch.frame[0]
    env.step(np.zeros((1, 18), np.float32))
    assert env._batch.frame[0] == frame


def test_the_terminal_observation_shows_the_last_frame_also_in_one_episode_mode() -> None:
    env = DynahoiVectorEnv(1, kind="constant", **SMALL)
    env.reset(seed=[0], options={"lerobot_new_rollout": True})
    while not (step := follow_expert(env, 1)[0])[2][0]:
        pass
    assert step[0]["pixels"]["ego"][0].std() > 5.0
    after, *_ = env.step(np.zeros((1, 18), np.float32))
    assert not after["pixels"]["ego"].any(), "a world that stands still costs no rendering"


def test_seeds_number_the_episodes_of_kind_and_split() -> None:
    env = DynahoiVectorEnv(3, kind="lob", split="test_small", **BLIND)
    env.reset(seed=4)
    names = Recipe(split="test").motion_names
    expected = [names.index("lob") + 22 * (number % 5) for number in (4, 5, 6)]
    assert [spec.seed for spec in env._batch.specs if spec is not None] == expected
    assert [kind_seed(Recipe(split="test_small"), "lob", n) for n in (4, 5, 6)] == expected


def test_env_and_rollout_play_the_same_episode() -> None:
    kept = []
    env = DynahoiVectorEnv(1, on_episode=kept.append, **BLIND)
    env.reset(seed=[7])
    while not kept:
        follow_expert(env, 1)
    recipe = Recipe(split="test", **SMALL)
    (episode,) = evaluate(WorldBatch(recipe, 1), Intercept(), [sample_spec(recipe, 7)])
    np.testing.assert_allclose(kept[0].state, episode.state, atol=1e-6)  # the env's actions were rounded to float32
    assert kept[0].stage == episode.stage == "captured"


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (np.zeros((2, 18)), "shape (1, 18), got (2, 18)"),
        (np.zeros((1, 17)), "shape (1, 18), got (1, 17)"),
        (np.full((1, 18), np.nan), "world 0 must be finite, got nan at index 0"),
        (np.full((1, 18), np.inf), "got inf"),
        (np.full((1, 18), 1j), "action must hold real numbers, got dtype complex128"),
        (np.full((1, 18), "2026-01-01", "M8[D]"), "action must hold real numbers, got dtype datetime64[D]"),
        (np.full((1, 18), "0.5"), "action must hold real numbers, got dtype <U3"),
    ],
)
def test_bad_actions_are_refused_and_nothing_moves(action: np.ndarray, words: str) -> None:
    env = DynahoiVectorEnv(1, **BLIND)
    env.reset(seed=[0])
    before = env._batch._batch.state.copy()
    with pytest.raises(ValueError, match="action") as error:
        env.step(action)
    assert words in str(error.value)
    np.testing.assert_array_equal(env._batch._batch.state, before)


def test_direct_act_has_no_window() -> None:
    env = DynahoiEnv(kind="struck", protocol="direct_act", **BLIND)
    observation, _ = env.reset(seed=0)
    assert observation["phase"].tolist() == [0.0, 1.0]
    assert env._vector._batch.specs[0].window_frames == 0


def test_without_images_nothing_is_rendered() -> None:
    env = DynahoiVectorEnv(1, **BLIND)
    observation, _ = env.reset(seed=[0])
    assert "pixels" not in observation
    assert not env._batch.cameras._renderers


def test_the_physical_track_shows_forces_and_succeeds_by_holding() -> None:
    kept = []
    contact = {"capture": "contact", "on_episode": kept.append}
    env = DynahoiVectorEnv(1, kind="constant", image_size=0, **contact)
    observation, _ = env.reset(seed=[0])
    assert observation["touch"].shape == (1, 5)
    expert, strongest = EXPERTS["match"](), 0.0
    while not kept:
        batch = env._batch
        commands = expert.act(batch.world_state(batch.observe(images=False)))
        observation, _, _, _, info = env.step(commands.astype(np.float32))
        assert env.observation_space.contains(observation)
        strongest = max(strongest, float(observation["touch"].max()))
    assert strongest > 1.0
    assert kept[0].stage == "held"
    assert info["is_success"][0]
    plain = DynahoiVectorEnv(1, kind="constant", image_size=0)
    assert "touch" not in plain.reset(seed=[0])[0]
