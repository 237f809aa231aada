"""The config behind ``--env.type=dynahoi``: what LeRobot may set, and the vector envs it gets."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import OBS_ENV_STATE

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.control_class import DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.env.rewards import SPARSE, check_reward
from dynahoi_lerobot.feature import Feature
from dynahoi_lerobot.features import frame_features
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.protocol import DEFAULT_PROTOCOL
from dynahoi_lerobot.renderers import DEFAULT_RENDERER, RENDERERS
from dynahoi_lerobot.rollout.inference import SYNC, Inference
from dynahoi_lerobot.rollout.stepwise_inference import StepwiseInference
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import seed_stream
from lerobot_env_dynahoi.command_line import new_results_folder, policy_rules
from lerobot_env_dynahoi.played_policy import queued_policy
from lerobot_env_dynahoi.task_env import ResultsLog, TaskEnv

DEFAULT_RULES = {"control_class": DEFAULT_CONTROL_CLASS, "protocol": DEFAULT_PROTOCOL, "image_size": 128}
RECIPE_FIELDS = {field.name for field in fields(Recipe)}
"""Fields of the config of these names go to the env."""


@EnvConfig.register_subclass("dynahoi")
@dataclass
class DynahoiEnvConfig(EnvConfig):
    """Dynamic capture: one suite per category of motion, one task per kind.

    Attributes:
        task: one kind of motion, one category, several of either separated by commas, or None for all 22 kinds.
        split: ``test``, ``test_small``, ``val``, ``ood_speed``, ``ood_object``, ``ood_motion`` or ``train``. A seed is
            the number of an episode within split and kind of motion; fixed splits wrap around.
        image_size: side of the square images [px]; by default what the policy of the command line was trained on, or
            128.
        views: views besides ``ego``, the hand's camera, such as ``side`` or ``ego_depth``.
        appearance: what is randomised more strongly, such as ``lights`` or ``distractors``.
        protocol: see `protocol.py`; by default that policy's own, or ``observe_before_act``.
        control_class: limits of the hand and latency of its commands: ``unlimited``, ``standard`` or ``late``; by
            default that policy's own, or ``standard``.
        capture: capture rule, one of ``dynahoi list captures``.
        hand: embodiment, one of ``dynahoi list hands``; the capture rule's own if empty.
        renderer: one of ``dynahoi list renderers``.
        instructions: ``reveal``, ``neutral`` or ``mixed``.
        inference: ``sync``, the world waits for the policy, or ``async``, its inferences take ``latency_ms``, one at a
            time (`stepwise_inference.py`).
        latency_ms: time from an observation to the chunk that answers it [ms].
        n_action_steps: the policy's, where LeRobot's command line does not name the policy; else leave it 0.
        environment_state: whether policies see the simulator's truth, pose and velocity of the target, as
            ``observation.environment_state``; results are then marked as privileged.
        reward: ``sparse`` or ``dense``, see `dynahoi_lerobot.env.rewards`.
        results_dir: where the metrics go; a new folder below ``dynahoi`` in LeRobot's ``--output_dir`` if None.
    """

    task: str | None = None
    fps: int = CONTROL_HZ
    split: str = "test"
    image_size: int = 0
    views: tuple[str, ...] = ()
    appearance: tuple[str, ...] = ()
    protocol: str = ""
    control_class: str = ""
    capture: str = "attach"
    hand: str = ""
    renderer: str = DEFAULT_RENDERER
    instructions: str = "mixed"
    inference: str = SYNC
    latency_ms: float = 0.0
    n_action_steps: int = 0
    environment_state: bool = False
    reward: str = SPARSE
    results_dir: str | None = None
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fill in ``features`` (by Gymnasium key, images by dataset key) and ``features_map``; check all names.

        LeRobot's recording of evaluations looks for images under dataset keys, and for all else under Gymnasium's.

        Raises:
            ValueError: for an unknown name, naming the ones there are.
        """
        self._adopt_rules()
        recipe = self._recipe()
        kinds_of(self.task, recipe.motion_names)
        _ = HANDS[recipe.hand], RENDERERS[recipe.renderer]
        check_reward(self.reward)
        visible = frame_features(
            self.image_size,
            self.views,
            contact_sensors=CAPTURES[self.capture].uses_contact_sensors,
            environment_state=self.environment_state,
        )
        shown = {
            feature.key if feature.is_image else feature.gym_key: feature
            for feature in visible
            if feature.gym_key is not None
        }
        self.features = {key: PolicyFeature(_type(feature), feature.shape) for key, feature in shown.items()}
        self.features_map = {key: feature.key for key, feature in shown.items()}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the env."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name in RECIPE_FIELDS}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Return ``{category: {task number: env}}``; each env is one native batch, there is nothing to make async.

        Raises:
            ValueError: for a timing of inference that there is not, or that cannot be had with the policy.
        """
        del use_async_envs
        recipe = self._recipe()
        kinds = kinds_of(self.task, recipe.motion_names)
        timing = Inference(self.inference, self.latency_ms)
        policy = None if timing.mode == SYNC else queued_policy(self.n_action_steps)
        log = ResultsLog(self._results_folder(), self.split, recipe, timing.label, privileged=self.environment_state)
        suites: dict[str, dict[int, gym.vector.VectorEnv]] = {}
        for kind in kinds:
            tasks = suites.setdefault(MOTIONS[kind].category, {})
            stepwise = None if policy is None else StepwiseInference(policy, timing)
            options = {"reward": self.reward, "environment_state": self.environment_state, "inference": stepwise}
            options |= self.gym_kwargs
            tasks[len(tasks)] = TaskEnv(log, n_envs, kind=kind, **options)
        return suites

    def _adopt_rules(self) -> None:
        """Fill in what the config leaves open: what the policy was trained for, or else the defaults."""
        trained = policy_rules(sys.argv)
        adopted = [name for name in trained if not getattr(self, name)]
        for name, value in (DEFAULT_RULES | trained).items():
            setattr(self, name, getattr(self, name) or value)
        if adopted:
            print("playing as the policy was trained: " + ", ".join(f"{name} {trained[name]}" for name in adopted))

    def _recipe(self) -> Recipe:
        return Recipe(**{**self.gym_kwargs, "split": seed_stream(self.split)})

    def _results_folder(self) -> Path:
        if self.results_dir is not None:
            return Path(self.results_dir)
        return new_results_folder(sys.argv)


def _type(feature: Feature) -> FeatureType:
    if feature.is_image:
        return FeatureType.VISUAL
    if feature.key == OBS_ENV_STATE:
        return FeatureType.ENV
    return FeatureType.STATE if feature.observed else FeatureType.ACTION


def kinds_of(task: str | None, known: list[str]) -> list[str]:
    """Return the kinds that ``task`` names, in the order of ``known``.

    Raises:
        ValueError: if a name is neither a kind nor a category.
    """
    if task is None:
        return known
    wanted = [name.strip() for name in task.split(",")]
    categories = sorted({MOTIONS[kind].category for kind in known})
    for name in wanted:
        if name not in known and name not in categories:
            allowed = ", ".join([*known, *categories])
            raise ValueError(f"unknown task {name!r}; known kinds and categories: {allowed}")
    return [kind for kind in known if kind in wanted or MOTIONS[kind].category in wanted]
