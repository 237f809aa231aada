"""Four numbers of a grasp stand for 18, in the world, in the environment and in datasets alike."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot_env_dynahoi import DynahoiEnvConfig

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.control_mode import from_grasp, to_grasp
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.env.vector_env import DynahoiEnv, DynahoiVectorEnv
from dynahoi_lerobot.evaluate.checkpoint_rules import trained_for
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.rollout.loop import evaluate, record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

CLOSING_RAD = 0.03
"""One number closes all joints, and goals keep each of them within the grasp of a thin or thick
object: 0.026 rad apart for the ring among these episodes, 0.045 for a cone, the most among 66 of
``train``."""
RECORDING = Recording.of(control_mode="grasp", image_size=0, motions=("constant", "lob"))
RECIPE = RECORDING.recipe


def test_the_two_ways_are_inverse():
    rng = np.random.default_rng(0)
    hand = HANDS["capsule"]
    pose = (hand.open_joints(), hand.closed_joints())
    state = rng.normal(size=(5, 18))
    action = np.column_stack([rng.normal(size=(5, 3)), rng.random(5)])
    np.testing.assert_allclose(
        to_grasp(from_grasp(action, state, *pose), state, *pose), action, atol=1e-12
    )
    np.testing.assert_allclose(
        from_grasp(np.array([[0, 0, 0, 9.0]]), state[:1], *pose)[0, 3:], pose[1]
    )


def test_labels_of_both_modes_are_the_same_goals():
    hand = HANDS[RECIPE.rules.hand_name]
    poses = hand.open_joints(), hand.closed_joints()
    pairs = zip(
        record(RECORDING, range(4)),
        record(changed(RECORDING, {"control_mode": "joints"}), range(4)),
        strict=True,
    )
    for grasp, joints in pairs:
        assert grasp.action.shape == (len(grasp), 4)
        np.testing.assert_array_equal(grasp.executed_action, joints.executed_action)
        told = from_grasp(grasp.action, grasp.state, *poses)
        np.testing.assert_allclose(told[:, :3], joints.action[:, :3], atol=1e-5)
        np.testing.assert_allclose(told[:, 3:], joints.action[:, 3:], atol=CLOSING_RAD)


class Reaching(Agent):
    """Repeats the teacher's grasp actions of one recording."""

    name = "reaching"

    def __init__(self, actions: np.ndarray) -> None:
        self._actions = iter(actions)

    def act(self, observation: Observation) -> np.ndarray:
        return next(self._actions)[None].astype(np.float64)


def test_an_agent_that_gives_them_catches():
    (episode,) = record(changed(RECORDING, {"perturbed_share": 0.0}), [0])
    specs = sample_specs(RECIPE, [0])
    (again,) = evaluate(WorldBatch(RECIPE.rules, 1), Reaching(episode.action), specs)
    assert again.success
    np.testing.assert_allclose(again.state[:, :3], episode.state[:, :3], atol=1e-4)
    np.testing.assert_allclose(again.state[:, 3:], episode.state[:, 3:], atol=CLOSING_RAD)


def test_environments_take_four_numbers():
    env = DynahoiVectorEnv(2, image_size=0, control_mode="grasp")
    assert env.action_space.shape == (2, 4)
    observation, _ = env.reset(seed=0)
    forward = np.tile(np.array([0.02, 0.0, 0.0, 1.0], np.float32), (2, 1))
    while not observation["phase"][:, 1].all():
        observation, *_ = env.step(forward)
    start = observation["agent_pos"]
    for _ in range(4):
        observation, *_ = env.step(forward)
    moved = observation["agent_pos"] - start
    np.testing.assert_allclose(moved[:, :3], [[0.08, 0, 0]] * 2, atol=5e-3)
    assert (observation["agent_pos"][:, 3:].max(axis=1) > 0.5).all()
    with pytest.raises(ValueError, match=r"\(2, 18\)"):
        env.step(np.zeros((2, 18)))
    assert DynahoiEnv(image_size=0, control_mode="grasp").action_space.shape == (4,)
    assert gym.make("dynahoi/all-v0", image_size=0, control_mode="grasp").action_space.shape == (4,)
    assert DynahoiEnvConfig(control_mode="grasp").features["action"].shape == (4,)


def test_a_checkpoint_says_in_a_word_what_its_actions_and_its_state_are(tmp_path: Path):
    state = {ENVIRONMENT_STATE: PolicyFeature(FeatureType.ENV, (13,))}
    output = {"action": PolicyFeature(FeatureType.ACTION, (4,))}
    ACTConfig(input_features=state, output_features=output, device="cpu").save_pretrained(tmp_path)
    assert trained_for(tmp_path) == {"views": ()}
    words = {"control_mode": "grasp", "environment_state": "truth"}
    (tmp_path / "train_config.json").write_text(json.dumps({"env": {"type": "dynahoi"} | words}))
    assert trained_for(tmp_path) == words | {"views": ()}
