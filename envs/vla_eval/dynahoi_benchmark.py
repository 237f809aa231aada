"""The benchmark for ``vla-eval``, whose model servers play OpenVLA, OpenVLA-OFT, pi0 and others.

benchmarks:
  - benchmark: "dynahoi_benchmark:DynahoiBenchmark"
    episodes_per_task: 5
    params: {split: test_small, image_size: 224}

With ``inference: async``, ``latency_ms: 150`` and the server's ``n_action_steps`` the world moves
on while the server infers, one inference at a time. What the requests really take counts in
vla-eval's own live mode, with ``hz: 20``.
"""

import math
from typing import Any, ClassVar

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult, repeat_last_hold
from vla_eval.specs import DimSpec
from vla_eval.types import Action, EpisodeResult, Observation, Task

from dynahoi_lerobot.core.conventions import HAND_DOF
from dynahoi_lerobot.core.lerobot_internals import ONE_EPISODE_OPTION
from dynahoi_lerobot.env.vector_env import DynahoiVectorEnv
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.rollout.inference import SYNC, Inference, StepwiseInference
from dynahoi_lerobot.sampling.recipe import Recipe

LONGEST_FRAMES = 256


class DynahoiBenchmark(StepBenchmark):
    """One task per motion; results carry every metric of the benchmark."""

    render_backends: ClassVar[frozenset[str]] = frozenset({"cpu", "gpu"})

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Return no environment variables: the renderer needs no OpenGL."""
        del mode
        return {}

    def __init__(
        self,
        *,
        kinds: list[str] | None = None,
        send_state: bool = True,
        inference: str = SYNC,
        latency_ms: float = 0.0,
        n_action_steps: int = 1,
        **fields: Any,
    ) -> None:
        """Configure the benchmark.

        Args:
            kinds: names of the motions; all of the split if None.
            send_state: whether observations contain the hand's state.
            inference, latency_ms: ``async`` and how long an inference of the server takes [ms], see
                `Inference`.
            n_action_steps: how many actions of a chunk the server hands out before it infers again.
            fields: of the ``Recipe``, such as ``image_size``; the split is ``test_small`` by
                default.

        Raises:
            ValueError: for an unknown field or value, or a timing that cannot be had with such a
                server.
        """
        super().__init__()
        timing = Inference(inference, latency_ms)
        self._inference: StepwiseInference | None = None
        if inference != SYNC:
            self._inference = StepwiseInference(timing, "the model server", n_action_steps)
        self._recipe = Recipe.of(**{"split": "test_small"} | fields)
        self._kinds = kinds
        self._send_state = send_state
        self._env: DynahoiVectorEnv | None = None

    def get_tasks(self) -> list[Task]:
        """Return one task per motion, in suites by category."""
        kinds = self._kinds or self._recipe.motion_names
        return [{"name": kind, "suite": MOTIONS[kind].category} for kind in kinds]

    def reset(self, task: Task) -> dict[str, Any]:
        """Start episode ``episode_idx`` of the task; return the first observation."""
        if self._env is None or self._env.kind != task["name"]:
            self.cleanup()
            self._env = DynahoiVectorEnv(
                1, recipe=self._recipe, kind=task["name"], inference=self._inference
            )
        observation, _ = self._env.reset(
            seed=[int(task.get("episode_idx", 0))], options={ONE_EPISODE_OPTION: True}
        )
        return observation

    def step(self, action: Action) -> StepResult:
        """Advance by one frame, 0.05 s, or by one call of a server whose inference takes time."""
        assert self._env is not None, "start an episode first"
        command = np.asarray(action.get("actions", action.get("action")), np.float64).reshape(1, -1)
        observation, reward, terminated, truncated, info = self._env.step(command)
        return StepResult(observation, float(reward[0]), bool(terminated[0] or truncated[0]), info)

    def make_obs(self, raw_obs: dict[str, Any], task: Task) -> Observation:
        """Return image, instruction and, if asked for, the (18,) state in the harness's
        convention.
        """
        assert self._env is not None
        observation: Observation = {
            "images": {"ego": raw_obs["pixels"]["ego"][0]},
            "task_description": self._env.task_description[0],
        }
        return observation | ({"states": raw_obs["agent_pos"][0]} if self._send_state else {})

    def get_step_result(self, step_result: StepResult) -> EpisodeResult:
        """Return success and every metric that applies to the episode."""
        info = step_result.info
        values = {name: float(info[name][0]) for name in METRICS.names() if name in info}
        if not values:  # the harness gave up before the episode ended
            return {"success": False}
        applying = {name: value for name, value in values.items() if not math.isnan(value)}
        return {"success": bool(info["is_success"][0]), **applying}

    def get_metric_keys(self) -> dict[str, str]:
        """Return how to aggregate: rates and means alike are averages over the episodes they apply
        to.
        """
        return dict.fromkeys(("success", *METRICS.names()), "mean")

    def get_metadata(self) -> dict[str, Any]:
        """Return the most steps of an episode, window included, and the size of an action."""
        steps = LONGEST_FRAMES if self._inference is None else self._inference.calls(LONGEST_FRAMES)
        return {"max_steps": steps, "action_dim": HAND_DOF}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Return the action space: palm position [m], absolute in the home frame, and joint angles
        [rad].
        """
        return {
            "position": DimSpec("position", 3, "absolute_xyz"),
            "joints": DimSpec("joints", 15, "absolute_rad"),
        }

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Return the observation space."""
        spec = {
            "image": DimSpec("image", 0, "rgb_hwc_uint8"),
            "language": DimSpec("language", 0, "language"),
        }
        return spec | (
            {"state": DimSpec("state", HAND_DOF, "palm_xyz_joint_rad")} if self._send_state else {}
        )

    def get_hold_action(self, last_action: Action | None) -> Action:
        """Return the last target, which is absolute."""
        return repeat_last_hold(last_action, HAND_DOF)

    def cleanup(self) -> None:
        """Close the env."""
        if self._env is not None:
            self._env.close()
            self._env = None

    def render(self) -> np.ndarray | None:
        """Return the current image of the hand's camera, (H, W, 3) uint8 RGB."""
        frames = None if self._env is None else self._env.render()
        return None if frames is None else np.asarray(frames[0])
