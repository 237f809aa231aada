"""The config behind ``--env.type=dynahoi``: what LeRobot may set, and the vector envs it gets."""

from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from types import MappingProxyType
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.processor import PolicyProcessorPipeline, RenameObservationsProcessorStep
from lerobot.utils.constants import OBS_ENV_STATE

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.features import TRUTH, Feature
from dynahoi_lerobot.core.nested import changed, leaves
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.env.vector_env import REWARDS, SPARSE
from dynahoi_lerobot.evaluate.results import RunInfo
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.rollout.inference import SYNC, Inference
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from lerobot_env_dynahoi.command_line import Launch, read_launch
from lerobot_env_dynahoi.task_env import ResultsLog, TaskEnv

OFFERED: dict[str, Any] = {
    entry.name: entry.type for _, entry in leaves(Recipe) if entry.name != "motions"
}
"""Types of the fields of recipe and rules that are options here, too; ``task`` names the
motions."""
NEEDED = {
    "max_parallel_tasks": (1, "because LeRobot's parallel tasks share one policy and its memory"),
    "fps": (CONTROL_HZ, "the rate of the simulation's commands and frames"),
    "disable_env_checker": (True, "because Gymnasium checks no vector environment"),
}
"""Options of LeRobot's with one value, and why."""
RecipeFields = make_dataclass(
    "RecipeFields", [(name, hint | None, field(default=None)) for name, hint in OFFERED.items()]
)
"""These fields, None where nothing is said."""


@EnvConfig.register_subclass("dynahoi")
@dataclass
class DynahoiEnvConfig(RecipeFields, EnvConfig):
    """Dynamic capture: one suite per category of motion, one task per kind.

    The fields of `Rules` are fields here as well, such as ``capture``, ``control_class`` and
    ``image_size``; one that is None is as the policy of the command line was trained, or else as in
    the rules by default. So are the fields of `Recipe`, such as ``split``, by default ``test``.
    A seed is the number of an episode within split and kind of motion; fixed splits wrap around.

    Attributes:
        task: one kind of motion, one category, several of either separated by commas, or None for
            all 22 kinds. A registered motion outside the split is played if it is named, as by
            ``dynahoi evaluate --motions``.
        inference: ``sync``, the world waits for the policy, or ``async``, its inferences take
            ``latency_ms``, one at a time (`rollout.inference.StepwiseInference`).
        latency_ms: time from an observation to the chunk that answers it [ms].
        n_action_steps: the policy's, where LeRobot's command line does not name the policy; else
            leave it 0.
        reward: ``sparse`` or ``dense``, see `dynahoi_lerobot.env.vector_env.REWARDS`.
        results_dir: where the metrics go, in training each evaluation's to a new folder in it; a
            new folder below ``dynahoi`` in LeRobot's ``--output_dir`` if None.
    """

    task: str | None = None
    fps: int = CONTROL_HZ
    inference: str = SYNC
    latency_ms: float = 0.0
    n_action_steps: int = 0
    reward: str = SPARSE
    results_dir: str | None = None
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check all names, and fill in ``features`` and ``features_map``.

        Raises:
            ValueError: for an unknown name, naming the ones there are, for more than one task at a
                time, or for an option of LeRobot's that has no effect here.
        """
        for name, (needed, reason) in NEEDED.items():
            if getattr(self, name) != needed:
                told = f"must be {str(needed).lower()}, {reason}"
                raise ValueError(f"env.{name} {told}, got {str(getattr(self, name)).lower()}")
        timing = Inference(self.inference, self.latency_ms)
        if self.n_action_steps and timing.mode == SYNC:
            told = "is read with env.inference=async alone; leave it out"
            raise ValueError(f"env.n_action_steps {told}, got {self.n_action_steps}")
        recipe = self.recipe()
        known("reward", self.reward, REWARDS)
        self._describe(recipe.rules)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the env."""
        return {"recipe": self.recipe()}

    def recipe(self, trained: dict[str, Any] | None = None) -> Recipe:
        """Return what is played: what is given, else what a policy was ``trained`` for, else the
        defaults.
        """
        given = {name: getattr(self, name) for name in OFFERED}
        told = {name: value for name, value in given.items() if value is not None}
        recipe = changed(Recipe(split="test"), (trained or {}) | told)
        kinds = kinds_of(self.task, recipe.motion_names)
        return recipe if set(kinds) <= set(recipe.motion_names) else replace(recipe, motions=kinds)

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Return ``{category: {task number: env}}``; each env is one native batch, there is nothing
        to make async.

        Raises:
            ValueError: for a timing of inference that there is not, or that cannot be had with the
                policy, or if ``results_dir`` holds results.
        """
        del use_async_envs
        timing = Inference(self.inference, self.latency_ms)
        launch = read_launch(policy_config=timing.mode != SYNC)
        recipe = self.recipe(launch.rules)
        self._announce(launch)
        self._describe(recipe.rules, launch.renames)
        log = self._log(launch, recipe, timing)
        suites: dict[str, dict[int, gym.vector.VectorEnv]] = {}
        for kind in kinds_of(self.task, recipe.motion_names):
            tasks = suites.setdefault(MOTIONS[kind].category, {})
            options: dict[str, Any] = {"recipe": recipe, "reward": self.reward}
            if timing.mode != SYNC:
                options["inference"] = launch.stepwise(timing, self.n_action_steps)
            tasks[len(tasks)] = TaskEnv(n_envs, on_episode=log, kind=kind, **options)
        return suites

    def get_env_processors(self) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
        """Return what LeRobot passes observations and actions through: the images get the names
        that the policy of the command line knows them by.
        """
        renaming = RenameObservationsProcessorStep(read_launch().renames)
        return PolicyProcessorPipeline([renaming]), PolicyProcessorPipeline([])

    def _log(self, launch: Launch, recipe: Recipe, timing: Inference) -> ResultsLog:
        """Return what writes the results."""
        info = RunInfo.begun(
            launch.policy,
            recipe,
            launch.weights,
            inference=timing.label,
            privileged=recipe.rules.environment_state == TRUTH,
        )
        return ResultsLog(launch.results_folder(self.results_dir), info)

    def _announce(self, launch: Launch) -> None:
        """Print the rules that nobody gave and that are not the default."""
        usual = Rules()
        told = [
            f"{name} {','.join(value) if name == 'views' else value}"
            for name, value in launch.rules.items()
            if getattr(self, name) is None and value != getattr(usual, name)
        ]
        if told:
            print(f"playing as the policy was trained: {', '.join(told)}")

    def _describe(self, rules: Rules, renames: Mapping[str, str] = MappingProxyType({})) -> None:
        """Fill in ``features`` (by Gymnasium key, images by dataset key) and ``features_map``.

        LeRobot's recording of evaluations looks for images under dataset keys, and for all else
        under Gymnasium's.
        """
        shown = {
            feature.key if feature.is_image else feature.gym_key: feature
            for feature in rules.features
            if feature.gym_key is not None
        }
        self.features = {
            key: PolicyFeature(_type(feature), feature.shape) for key, feature in shown.items()
        }
        self.features_map = {
            key: renames.get(feature.key, feature.key) for key, feature in shown.items()
        }


def _type(feature: Feature) -> FeatureType:
    if feature.is_image:
        return FeatureType.VISUAL
    if feature.key == OBS_ENV_STATE:
        return FeatureType.ENV
    return FeatureType.STATE if feature.observed else FeatureType.ACTION


def kinds_of(task: str | None, usual: list[str]) -> tuple[str, ...]:
    """Return the kinds that ``task`` names: of the ``usual`` ones of a split in their order, and
    then other registered ones.

    Raises:
        ValueError: if a name is neither a registered kind nor a category of the usual ones.
    """
    if task is None:
        return tuple(usual)
    wanted = [name.strip() for name in task.split(",")]
    categories = sorted({MOTIONS[kind].category for kind in usual})
    others = [name for name in MOTIONS.names() if name not in usual]
    names = dict.fromkeys([*usual, *categories, *others])
    for name in wanted:
        known("task", name, names)
    named = [kind for kind in usual if kind in wanted or MOTIONS[kind].category in wanted]
    return (*named, *(kind for kind in others if kind in wanted))
