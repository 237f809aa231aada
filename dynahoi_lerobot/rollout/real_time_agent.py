"""One inference at a time: a chunk is ready when its inference has ended, and the world moves on meanwhile."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynahoi_lerobot.agent import Agent, ChunkAgent, Observation
from dynahoi_lerobot.rollout.chunk import Chunk
from dynahoi_lerobot.rollout.inference import RTC, Inference, frames_of


class RealTimeAgent(Agent):
    """Executes the chunks of an agent whose inference takes time, world by world.

    An inference begins with the observation of frame t and its chunk, whose first action is for frame t, is ready d
    frames later: what is past is skipped. Meanwhile the old chunk goes on. The next inference begins when the last has
    ended. Until the first chunk is ready, a hand stays where it is; after the last action of a chunk, where that led.
    """

    def __init__(self, agent: ChunkAgent, inference: Inference) -> None:
        """Give ``agent`` the timing ``inference``, of mode ``async`` or ``rtc``.

        Raises:
            ValueError: for ``rtc`` with an agent that cannot be guided, or a correction by one that corrects nothing.
        """
        if inference.mode == RTC and not agent.accepts_guidance:
            raise ValueError(
                f"inference mode rtc guides a chunk while it is generated, which {agent.name!r} does not support; "
                "use async"
            )
        if inference.corrected and not agent.corrects:
            raise ValueError(
                f"{agent.name!r} does not correct its chunks while they are executed; leave the correction out"
            )
        self.name, self.sees_images = agent.name, agent.sees_images
        self.image_size, self.views = agent.image_size, agent.views
        self.sees_environment_state, self.privileged = agent.sees_environment_state, agent.privileged
        self.weights, self.trained_for = agent.weights, agent.trained_for
        self._told = inference.mode == RTC or agent.accepts_prefix
        if inference.mode == RTC:
            agent.enable_guidance()
        self._agent, self._inference = agent, inference
        self._inferences, self._waited_frames = 0, 0
        self.reset(0)

    def reset(self, count: int) -> None:
        """Forget everything, also what is being inferred."""
        self._agent.reset(count)
        self._frame = 0
        self._delays = self._declared(count)
        self._running: list[Chunk | None] = [None] * count
        self._coming: list[Chunk | None] = [None] * count

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) the commands that are due."""
        self._receive()
        starting = np.array([i for i, chunk in enumerate(self._coming) if chunk is None], int)
        if starting.size:
            self._infer(observation, starting)
            self._receive()
        else:
            self._agent.watch(observation)
        commands = self._commands(observation)
        self._frame += 1
        return commands

    def _commands(self, observation: Observation) -> np.ndarray:
        """Return what is due of the running chunks, or the corrections of that."""
        commands = observation.state.astype(np.float64)
        running = {i: chunk for i, chunk in enumerate(self._running) if chunk is not None}
        if running and self._inference.corrected:
            ages = [self._frame - chunk.first for chunk in running.values()]
            expectations = [chunk.expectation for chunk in running.values()]
            commands[list(running)] = self._agent.corrected(np.array(list(running)), expectations, ages)
        else:
            for i, chunk in running.items():
                commands[i] = chunk.action(self._frame)
        return commands

    def report(self) -> dict[str, Any]:
        """Return the agent's report, and how many frames an inference took on average."""
        frames = self._waited_frames / max(self._inferences, 1)
        return {**self._agent.report(), "inference_frames": round(frames, 3)}

    def _receive(self) -> None:
        """Go on with the chunks that are ready at this frame."""
        for i, chunk in enumerate(self._coming):
            if chunk is not None and chunk.ready <= self._frame:
                self._running[i], self._coming[i] = chunk, None

    def _declared(self, count: int) -> list[int | None]:
        """Return how long the inferences of each world take [frames]; None is what they take on this machine."""
        declared = self._inference.latency_ms
        return [None if declared is None else frames_of(declared / 1000)] * count

    def _infer(self, observation: Observation, worlds: np.ndarray) -> None:
        """Begin an inference in each of the sorted ``worlds`` (n,)."""
        plan = self._agent.plan(observation, worlds, **(self._continued(worlds) if self._told else {}))
        expectations = plan.expectations if self._inference.corrected else [None] * len(worlds)
        for i, actions, seconds, expectation in zip(worlds, plan.actions, plan.seconds, expectations, strict=True):
            delay = self._delays[i]
            self._check(len(actions), delay)
            took = frames_of(seconds) if delay is None else delay
            self._coming[i] = Chunk(actions, self._frame, self._frame + took, expectation)
            self._inferences, self._waited_frames = self._inferences + 1, self._waited_frames + took

    def _continued(self, worlds: np.ndarray) -> dict[str, np.ndarray]:
        """What goes on in ``worlds`` (n,) meanwhile; an inference is expected to take as long as the last one."""
        old = [chunk for i in worlds if (chunk := self._running[i]) is not None]
        lasted = [chunk.ready - chunk.first for chunk in old] or [0] * len(worlds)
        delays = [self._delays[i] for i in worlds]
        told = {"delays": np.array([last if d is None else d for last, d in zip(lasted, delays, strict=True)])}
        return told | ({"executed": np.array([self._frame - chunk.first for chunk in old])} if old else {})

    def _check(self, length: int, delay: int | None) -> None:
        """Raise ValueError if a chunk is over before it is ready."""
        if delay is not None and delay >= length:
            raise ValueError(
                f"the chunks of {self.name!r} have {length} actions, all of them past when a chunk is ready after "
                f"{delay} frames; allowed are less than {length} frames"
            )
