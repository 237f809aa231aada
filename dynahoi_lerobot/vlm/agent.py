"""A vision-language model as an agent: one decision per world for every ten frames of the control
phase.

An OpenAI-compatible endpoint is asked, with one deadline per decision and an account of what was
asked. What a server says may repeat the API key, so nothing of it is stored but valid answers and
token counts.
"""

import asyncio
import json
import os
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import openai
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import EGO_VIEW, HAND_DOF
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES, DEFAULT_CONTROL_CLASS, is_acting
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, HORIZON, PROMPTS, SKILLS, messages

MAX_TOKENS = 4096
MOST_ANSWERS = 3
"""Answers that a decision asks for until one is valid."""
HTTP_URL = re.compile(r"https?://(\[[\da-fA-F:]+\]|[\w.-]+)(:\d+)?(/[^\s@]*)?")


class VlmAgent(Agent):
    """Executes the action chunks that a model answers with.

    After a failed decision the hand holds its pose for as many frames as a chunk has, and the
    failure is counted.
    """

    sees_images = True
    control_mode = JOINTS
    plans = True

    def __init__(self, client: "VlmClient", *, name: str = "vlm") -> None:
        """Ask ``client`` about all worlds that need a chunk at the same time."""
        self.name = name
        self._client = client
        self._planned: list[deque[np.ndarray]] = []

    def reset(self, count: int) -> None:
        """Drop the chunks of earlier episodes; ``count`` new episodes begin."""
        self._planned = [deque() for _ in range(count)]

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) commands, palm center [m], home frame, and joints [rad], once the
        decisions due are made.
        """
        in_play = is_acting(observation.phase) & observation.images[EGO_VIEW].any(
            axis=(1, 2, 3)
        )  # others are black
        due = [i for i, queue in enumerate(self._planned) if not queue and in_play[i]]
        states = observation.state.astype(np.float64)
        chunks, _ = self.plan(observation, np.array(due, int))
        for i, commands in zip(due, chunks, strict=True):
            self._planned[i].extend(commands)
        return np.stack(
            [
                queue.popleft() if queue else state
                for queue, state in zip(self._planned, states, strict=True)
            ]
        )

    def plan(
        self, observation: Observation, worlds: np.ndarray, **_: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a chunk for each of ``worlds`` (n,) and the seconds that each decision took.

        Worlds whose episode has ended are skipped. A model continues no earlier chunk.
        """
        shown = [i for i in worlds.tolist() if observation.images[EGO_VIEW][i].any()]
        actions = np.repeat(observation.state[:, None].astype(np.float64), HORIZON, axis=1)
        seconds = np.zeros(len(observation.state))
        asked = [
            (observation.tasks[i], actions[i, 0], observation.images[EGO_VIEW][i]) for i in shown
        ]
        for i, (commands, took) in zip(shown, self._client.plan(asked), strict=True):
            seconds[i] = took
            if commands is not None:
                actions[i] = commands
        return actions[worlds], seconds[worlds]

    def report(self) -> dict[str, Any]:
        """Return the account of the client under ``vlm``."""
        return {"vlm": self._client.report()}


class VlmClient:
    """One model behind one endpoint.

    Requests run in an event loop on a thread of their own, side by side, where the deadline of a
    decision ends them wherever they wait. The ``openai`` package repeats what fails on the way, and
    pauses as a busy server asks it to.
    """

    def __init__(
        self,
        model: str,
        base_url: str | None = None,
        *,
        timeout_s: float = 60.0,
        prompt: str = DEFAULT_PROMPT,
        palm_speed_m_s: float = CONTROL_CLASSES[DEFAULT_CONTROL_CLASS].palm_speed_m_s,
        log: Path | None = None,
    ) -> None:
        """Prepare requests to ``base_url``; the API key is read from the environment variable
        ``OPENAI_API_KEY``.

        Args:
            model: its name at the endpoint.
            base_url: of the endpoint, usually ending in ``/v1``; None is OpenAI's.
            timeout_s: for one decision [s], all its requests included.
            prompt, palm_speed_m_s: the question, see ``prompt.messages``.
            log: a JSON-lines file to which a line is appended for every answer, or failure to get
                one.

        Raises:
            ValueError: for an unknown prompt or an invalid URL, or if the endpoint is OpenAI's and
                there is no key.
        """
        known("prompt", prompt, PROMPTS)
        self._model = model
        self._timeout_s = timeout_s
        self._log = log
        self._prompt = prompt
        self._palm_speed_m_s = palm_speed_m_s
        self._structured = True
        self._totals = dict.fromkeys(
            ("decisions", "failed", "answers", "prompt_tokens", "completion_tokens"), 0
        )
        self._problems: Counter[str] = Counter()
        self._seconds = 0.0
        self._client = _connect(base_url)
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True, name="vlm").start()

    def plan(
        self, worlds: Sequence[tuple[str, np.ndarray, np.ndarray]]
    ) -> list[tuple[np.ndarray | None, float]]:
        """Decide for several worlds at the same time.

        Args:
            worlds: the instruction; (18,) palm center position [m], home frame, and joint angles
                [rad]; and (H, W, 3) uint8 RGB of the hand's camera.

        Returns:
            For each of them, the commands for the next frames, (10, 18) palm center position [m],
            home frame, and joint angles [rad], one row for each frame of 0.05 s, or None if the
            server gives no valid answer in time; and the decision's duration [s].
        """

        async def decide() -> list[tuple[np.ndarray | None, float]]:
            return await asyncio.gather(*(self._decide(*world) for world in worlds))

        return asyncio.run_coroutine_threadsafe(decide(), self._loop).result()

    def report(self) -> dict[str, Any]:
        """Return the names of model and prompt and the account so far, as JSON values.

        ``answers`` counts requests for an answer, ``problems`` those without a valid one by the
        exception's name, and ``seconds`` is the time spent waiting, summed over decisions.
        """
        return {
            "model": self._model,
            "prompt": self._prompt,
            "structured_output": self._structured,
            **self._totals,
            "seconds": self._seconds,
            "problems": dict(self._problems),
        }

    async def _decide(
        self, task: str, state: np.ndarray, image: np.ndarray
    ) -> tuple[np.ndarray | None, float]:
        """Ask until an answer is valid, ``MOST_ANSWERS`` are not or the deadline has passed."""
        start = time.monotonic()
        commands = None
        asked = messages(self._prompt, self._palm_speed_m_s, task, state, image)
        try:
            async with asyncio.timeout(self._timeout_s):
                for _ in range(MOST_ANSWERS):
                    try:
                        commands = await self._answer(task, asked)
                        break
                    except ReplyError as error:
                        self._note(task, error)
        except Exception as error:  # whatever a server provokes must not end an evaluation of hours
            self._note(task, error)
        self._totals["decisions"] += 1
        self._totals["failed"] += commands is None
        took = time.monotonic() - start
        self._seconds += took
        return commands, took

    async def _answer(self, task: str, messages: list[dict[str, Any]]) -> np.ndarray:
        """Return the commands of one answer; ReplyError if it is not in the requested format."""
        self._totals["answers"] += 1
        completion = await self._complete(messages)
        if completion.usage:
            self._totals["prompt_tokens"] += int(completion.usage.prompt_tokens)
            self._totals["completion_tokens"] += int(completion.usage.completion_tokens)
        commands, skills = parse_reply(completion.choices[0].message.content)
        self._write({"task": task, "skills": skills})
        return commands

    async def _complete(self, messages: list[dict[str, Any]]) -> Any:
        """Request a completion, with structured output as long as the server has not refused it."""
        create = self._client.chat.completions.create
        request: dict[str, Any] = {
            "model": self._model,
            "messages": messages,
            "max_tokens": MAX_TOKENS,
        }
        if self._structured:
            schema = {"name": "hand_motion", "schema": Answer.model_json_schema()}
            try:
                return await create(
                    **request, response_format={"type": "json_schema", "json_schema": schema}
                )
            except (openai.BadRequestError, openai.UnprocessableEntityError):
                self._structured = False  # many servers offer none
        return await create(**request)

    def _note(self, task: str, error: Exception) -> None:
        """Count a problem; its words are told only if they are ours."""
        name = type(error).__name__
        self._problems[name] += 1
        self._write(
            {"task": task, "problem": f"{name}: {error}" if isinstance(error, ReplyError) else name}
        )

    def _write(self, line: dict[str, Any]) -> None:
        if self._log:
            with self._log.open("a") as stream:
                stream.write(json.dumps(line) + "\n")


def _connect(base_url: str | None) -> Any:
    """Return an `openai.AsyncOpenAI` client, unless the URL or the environment's key cannot be
    right.
    """
    key = os.environ.get("OPENAI_API_KEY", "").strip()
    if base_url is None and not key:
        raise ValueError(
            "without --base-url the endpoint is OpenAI's and OPENAI_API_KEY must be set; it is not"
        )
    if base_url is not None and not HTTP_URL.fullmatch(
        base_url
    ):  # not repeated: results hold the command line
        raise ValueError(
            "the base URL must be like http://localhost:8000/v1, without user name or password"
        )
    return openai.AsyncOpenAI(
        api_key=key or "none", base_url=base_url
    )  # local servers check no key


# -- the answer, as pydantic reads it: anything that differs from the requested format is refused --


class ReplyError(ValueError):
    """An answer that is not in the requested format; the message says why."""


class Step(BaseModel):
    """One skill of the program. The simulator plays the rollout, so a step changes no command."""

    skill: Literal[SKILLS]  # type: ignore[valid-type]
    duration: Annotated[int, Field(ge=1, le=HORIZON)]
    params: Any = None
    terminate_if: Any = None


class Frame(BaseModel):
    """One frame of the rollout: palm center position [m], home frame, and joint angles [rad]."""

    hand_params: Annotated[list[FiniteFloat], Field(min_length=HAND_DOF, max_length=HAND_DOF)]


class Answer(BaseModel):
    """A skill program and the rollout of the next ``HORIZON`` frames (appendix "Details for
    Evaluating VLMs").
    """

    action_sequence: Annotated[list[Step], Field(min_length=1)]
    predicted_motion: Annotated[list[Frame], Field(min_length=HORIZON, max_length=HORIZON)]

    @model_validator(mode="after")
    def _durations_fill_the_horizon(self) -> Self:
        total = sum(step.duration for step in self.action_sequence)
        if total != HORIZON:
            raise ValueError(f"the durations sum to {total}; they must sum to {HORIZON}")
        return self


def parse_reply(text: str) -> tuple[np.ndarray, list[tuple[str, int]]]:
    """Return the commands of an answer and its skills; a Markdown fence around the JSON is
    accepted, no other text is.

    Returns:
        (10, 18) float64, palm center position [m], home frame, and joint angles [rad], finite but
        not clipped; and the name of each skill with its duration [frames].

    Raises:
        ReplyError: if the text is not JSON or not an ``Answer``.
    """
    body = text.strip()
    if body.startswith("```"):
        body = body.removeprefix("```").removeprefix("json").removesuffix("```")
    try:
        answer = Answer.model_validate_json(
            body, strict=True
        )  # numbers are neither text nor truth values
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"])) or "the answer"
        raise ReplyError(f"{place}: {first['msg']}"[:200]) from None
    commands = np.array([frame.hand_params for frame in answer.predicted_motion], np.float64)
    return commands, [(step.skill, step.duration) for step in answer.action_sequence]
