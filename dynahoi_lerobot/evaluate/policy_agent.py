"""A trained LeRobot policy as an agent, with LeRobot's own loading, processors and action
selection.

Nothing here imports torch or LeRobot before a policy is loaded.
"""

import time
from collections.abc import Callable, Sequence
from functools import wraps
from inspect import signature
from typing import Any

import numpy as np

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.features import (
    ENVIRONMENT_STATE,
    EYE,
    TRUTH,
    as_gym,
)
from dynahoi_lerobot.core.lerobot_internals import (
    accepts_guidance,
    as_policies_take,
    prepare_guidance,
    queued_frame,
)
from dynahoi_lerobot.evaluate.checkpoint import checked_folder, load_policy, reason
from dynahoi_lerobot.evaluate.checkpoint_files import PolicyError, folder_weights
from dynahoi_lerobot.evaluate.checkpoint_rules import trained_for


def _in_a_sentence[**P, R](method: Callable[P, R]) -> Callable[P, R]:
    """Raise whatever a policy raises while it plays as a PolicyError, of which that is the
    cause.
    """

    @wraps(method)
    def call(*args: P.args, **options: P.kwargs) -> R:
        try:
            return method(*args, **options)
        except PolicyError:
            raise
        except Exception as error:
            raise PolicyError(f"the policy cannot play: {reason(error)}") from error

    return call


class PolicyAgent(Agent):
    """Acts as ``lerobot-eval`` would with the same checkpoint folder or Hub repository.

    Attributes:
        package: the top-level package of the policy's class.
        seed: of torch's generator at the start of episodes, from which policies draw their noise.
        thoughts: the policy's record of each decision since then, None where it records
            nothing; None if nobody keeps them.
    """

    plans = True
    seed: int = 0
    thoughts: list[Any] | None = None

    def __init__(
        self,
        path: str,
        device: str | None = None,
        settings: Sequence[str] = (),
        *,
        trust: bool = False,
    ) -> None:
        """Load a policy and its processors; see ``checked_folder`` and ``load_policy`` for
        arguments and errors.
        """
        self.name = path
        folder = checked_folder(path, trust=trust)
        self._policy, self._before, self._after = load_policy(folder, device, settings, trust=trust)
        self.weights = folder_weights(folder)
        self.trained_for = trained_for(folder)
        self._chunk: Any = None
        self._frame = 0
        self._worlds = np.arange(0)  # that the policy plays
        self._guided = False
        taken = signature(self._policy.predict_action_chunk).parameters
        self._expects_delays = "inference_delay" in taken
        inputs = self._policy.config.input_features
        told = self.trained_for.get("environment_state") or None
        self.environment_state = told if ENVIRONMENT_STATE in inputs else ""
        self.privileged = self.environment_state == TRUTH
        self.sees_images = any(key.startswith("observation.image") for key in inputs)
        self.package = type(self._policy).__module__.partition(".")[0]
        self.views = self.trained_for["views"]

    def reset(self, count: int) -> None:
        """Forget queued actions and history, and seed torch's generator.

        So a group's draws depend on no group before it, and an interrupted
        evaluation goes on alike.
        """
        import torch

        torch.manual_seed(self.seed)
        self._policy.reset()
        self._chunk = None
        self._frame = 0
        self._worlds = np.arange(count)
        if self.thoughts is not None:
            self.thoughts.clear()

    def leave(self, worlds: np.ndarray) -> None:
        """Let a policy that can play on with some of its worlds alone do so."""
        if not hasattr(self._policy, "keep_rows") or self.thoughts is not None:
            return
        kept = np.setdiff1d(self._worlds, worlds)
        if self._policy.keep_rows(np.searchsorted(self._worlds, kept)):
            self._worlds = kept

    @_in_a_sentence
    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) float commands: palm position [m], home frame, and joint angles [rad];
        zeros where an episode has ended.
        """
        import torch

        with torch.inference_mode():
            action = self._policy.select_action(self._batch(observation.of(self._worlds)))
        if self.thoughts is not None:
            self.thoughts.append(getattr(self._policy, "decision", None))
        commands = self._commands(action)
        all_commands = np.zeros((len(observation.tasks), *commands.shape[1:]), commands.dtype)
        all_commands[self._worlds] = commands
        return all_commands

    @property
    def accepts_guidance(self) -> bool:
        """Whether the policy offers LeRobot's real-time chunking."""
        return accepts_guidance(self._policy)

    @_in_a_sentence
    def observe(self, observation: Observation) -> None:
        """Add a frame to the policy's history, if it has one: ``predict_action_chunk`` looks at the
        queues, to which only ``select_action`` adds by itself.
        """
        batch = self._batch(observation)
        if hasattr(self._policy, "observe"):
            self._policy.observe(batch)
        else:
            queued_frame(self._policy, batch)

    @_in_a_sentence
    def plan(
        self,
        observation: Observation,
        worlds: np.ndarray,
        *,
        executed: np.ndarray | None = None,
        delays: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a chunk for each of ``worlds`` (n,), and the seconds that the prediction for all
        worlds took.

        LeRobot predicts the chunks of all worlds together, so the chunks that they continue have
        the same age.

        Raises:
            PolicyError: if the policy predicts no chunks.
        """
        import torch

        start = time.perf_counter()
        batch = self._batch(observation)
        guidance: dict[str, Any] = {}
        if delays is not None and (executed is not None or self._expects_delays):
            guidance["inference_delay"] = int(delays[0])
        if executed is not None:
            if not self._guided:
                prepare_guidance(self._policy)
            self._guided = True
            # the normalized actions that are not executed yet; of a chunk that is over, where it
            # led
            past = min(int(executed[0]), self._chunk.shape[1] - 1)
            guidance["prev_chunk_left_over"] = self._chunk[:, past:]  # (N, n, 18)
        with torch.no_grad():  # not inference_mode: LeRobot's guidance differentiates
            try:
                self._chunk = self._policy.predict_action_chunk(
                    queued_frame(self._policy, batch), **guidance
                )
            except NotImplementedError as error:
                raise PolicyError(
                    f"{self.name} predicts no chunks of actions; use inference mode sync"
                ) from error
            actions = self._commands(self._chunk)[worlds]
        return actions, np.full(len(worlds), time.perf_counter() - start)

    def _commands(self, normalized: Any) -> np.ndarray:
        """What the policy's actions, as it predicts them, stand for."""
        commands: np.ndarray = self._after(normalized).to("cpu").numpy()
        if not np.isfinite(commands).all():
            raise PolicyError(f"{self.name} gives commands that are not finite numbers")
        return commands

    def _batch(self, observation: Observation) -> dict[str, Any]:
        """What the policy takes, as ``lerobot-eval`` prepares it."""
        import torch

        shown = {
            "": True,
            TRUTH: observation.environment_state is not None,
            EYE: observation.sighting is not None,
        }
        if not shown.get(self.environment_state or "", True):
            raise PolicyError(
                f"{self.name} reads {ENVIRONMENT_STATE}, which `dynahoi evaluate "
                f"--environment-state {self.environment_state}` and environments with "
                f"environment_state={self.environment_state!r} show"
            )
        batch = as_policies_take(as_gym(observation))
        batch["task"] = list(observation.tasks)
        batch = self._before(batch)
        n_worlds = len(observation.tasks)
        batch["timestamp"] = torch.full((n_worlds,), self._frame * CONTROL_DT)  # for its history
        self._frame += 1
        return batch
