"""The config behind ``--env.type=dynahoi``: what LeRobot may set, and the vector envs it gets."""

from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Any, get_type_hints

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import OBS_ENV_STATE

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.features import Feature
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.env.vector_env import REWARDS, SPARSE
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.rollout.inference import SYNC, Inference, StepwiseInference
from dynahoi_lerobot.sampling.recipe import PLAYING, Recipe
from lerobot_env_dynahoi.command_line import new_results_folder, policy_rules, queued_policy
from lerobot_env_dynahoi.task_env import ResultsLog, TaskEnv

RECIPE_FIELDS = tuple(name for name in PLAYING if name != "motions")
"""Fields of the recipe that the config offers; its ``task`` names the motions."""
RecipeFields = make_dataclass(
    "RecipeFields",
    [(name, get_type_hints(Recipe)[name] | None, field(default=None)) for name in RECIPE_FIELDS],
)
"""These fields, None where nothing is said."""


@EnvConfig.register_subclass("dynahoi")
@dataclass
class DynahoiEnvConfig(RecipeFields, EnvConfig):
    """Dynamic capture: one suite per category of motion, one task per kind.

    The fields of `Recipe` that matter to a policy are fields here as well, such as ``split``,
    ``image_size``, ``control_class`` and ``environment_state``. One that is None is as the policy
    of the command line was trained (``capture``, ``control_class``, ``protocol``, ``image_size``,
    ``views``), or else as in the recipe by default; the split is ``test``. A seed is the number of
    an episode within split and kind of motion; fixed splits wrap around.

    Attributes:
        task: one kind of motion, one category, several of either separated by commas, or None for
            all 22 kinds.
        inference: ``sync``, the world waits for the policy, or ``async``, its inferences take
            ``latency_ms``, one at a time (`rollout.inference.StepwiseInference`).
        latency_ms: time from an observation to the chunk that answers it [ms].
        n_action_steps: the policy's, where LeRobot's command line does not name the policy; else
            leave it 0.
        reward: ``sparse`` or ``dense``, see `dynahoi_lerobot.env.vector_env.REWARDS`.
        results_dir: where the metrics go; a new folder below ``dynahoi`` in LeRobot's
            ``--output_dir`` if None.
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
        """Fill in ``features`` (by Gymnasium key, images by dataset key) and ``features_map``;
        check all names.

        LeRobot's recording of evaluations looks for images under dataset keys, and for all else
        under Gymnasium's.

        Raises:
            ValueError: for an unknown name, naming the ones there are, or for more than one task at
                a time.
        """
        if self.max_parallel_tasks != 1:
            told = "must be 1, because LeRobot's parallel tasks share one policy and its memory"
            raise ValueError(f"env.max_parallel_tasks {told}, got {self.max_parallel_tasks}")
        recipe = self._recipe()
        for name in RECIPE_FIELDS:
            if name != "hand":  # which is the capture rule's where nothing is said
                setattr(self, name, getattr(recipe, name))
        kinds_of(self.task, recipe.motion_names)
        known("reward", self.reward, REWARDS)
        shown = {
            feature.key if feature.is_image else feature.gym_key: feature
            for feature in recipe.features()
            if feature.gym_key is not None
        }
        self.features = {
            key: PolicyFeature(_type(feature), feature.shape) for key, feature in shown.items()
        }
        self.features_map = {key: feature.key for key, feature in shown.items()}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the env."""
        return {"recipe": self._recipe()}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Return ``{category: {task number: env}}``; each env is one native batch, there is nothing
        to make async.

        Raises:
            ValueError: for a timing of inference that there is not, or that cannot be had with the
                policy.
        """
        del use_async_envs
        recipe = self._recipe()
        kinds = kinds_of(self.task, recipe.motion_names)
        timing = Inference(self.inference, self.latency_ms)
        policy = None if timing.mode == SYNC else queued_policy(self.n_action_steps)
        folder = new_results_folder() if self.results_dir is None else Path(self.results_dir)
        log = ResultsLog(folder, recipe, timing.label)
        suites: dict[str, dict[int, gym.vector.VectorEnv]] = {}
        for kind in kinds:
            tasks = suites.setdefault(MOTIONS[kind].category, {})
            stepwise = None if policy is None else StepwiseInference(policy, timing)
            options: dict[str, Any] = {
                "recipe": recipe,
                "reward": self.reward,
                "inference": stepwise,
            }
            tasks[len(tasks)] = TaskEnv(n_envs, on_episode=log, kind=kind, **options)
        return suites

    def _recipe(self) -> Recipe:
        """Return what is played: what is given, and else what the policy was trained for, which is
        printed.
        """
        given = {
            name: value for name in RECIPE_FIELDS if (value := getattr(self, name)) is not None
        }
        trained = {name: value for name, value in policy_rules().items() if name not in given}
        if trained:
            told = ", ".join(
                f"{name} {','.join(v) if name == 'views' else v}" for name, v in trained.items()
            )
            print(f"playing as the policy was trained: {told}")
        return Recipe(split="test").changed(**trained | given)


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
