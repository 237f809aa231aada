"""A client for an OpenAI-compatible endpoint, with one deadline per decision and an account of what was asked.

What a server says may repeat the API key, so nothing of it is stored but valid answers and token counts.
"""

import asyncio
import json
import os
import re
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import openai

from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.core.rules import CONTROL_CLASSES, DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, PROMPTS, messages
from dynahoi_lerobot.vlm.reply import Answer, ReplyError, parse_reply

MAX_TOKENS = 4096
MOST_ANSWERS = 3
"""Answers that a decision asks for until one is valid."""
HTTP_URL = re.compile(r"https?://(\[[\da-fA-F:]+\]|[\w.-]+)(:\d+)?(/[^\s@]*)?")


class VlmClient:
    """One model behind one endpoint; safe to use from several threads.

    Requests run in an event loop on a thread of their own, where the deadline of a decision ends them wherever they
    wait. The ``openai`` package repeats what fails on the way, and pauses as a busy server asks it to.
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
        """Prepare requests to ``base_url``; the API key is read from the environment variable ``OPENAI_API_KEY``.

        Args:
            model: its name at the endpoint.
            base_url: of the endpoint, usually ending in ``/v1``; None is OpenAI's.
            timeout_s: for one decision [s], all its requests included.
            prompt, palm_speed_m_s: what is asked, see ``prompt.messages``.
            log: a JSON-lines file to which a line is appended for every answer, or failure to get one.

        Raises:
            ValueError: for an unknown prompt or an invalid URL, or if the endpoint is OpenAI's and there is no key.
        """
        known("prompt", prompt, PROMPTS)
        self._model, self._timeout_s, self._log = model, timeout_s, log
        self._prompt, self._palm_speed_m_s = prompt, palm_speed_m_s
        self._structured = True
        self._totals = dict.fromkeys(("decisions", "failed", "answers", "prompt_tokens", "completion_tokens"), 0)
        self._problems: Counter[str] = Counter()
        self._seconds = 0.0
        self._client = _connect(base_url)
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True, name="vlm").start()

    def plan(self, task: str, state: np.ndarray, image: np.ndarray) -> np.ndarray | None:
        """Return the commands for the next frames, or None if the server gives no valid answer in time.

        Args:
            task: the instruction.
            state: (18,) palm centre position [m], home frame, and joint angles [rad].
            image: (H, W, 3) uint8 RGB of the hand's camera.

        Returns:
            (10, 18) palm centre position [m], home frame, and joint angles [rad], one row for each frame of 0.05 s.
        """
        asked = messages(self._prompt, self._palm_speed_m_s, task, state, image)
        return asyncio.run_coroutine_threadsafe(self._decide(task, asked), self._loop).result()

    def report(self) -> dict[str, Any]:
        """Return the names of model and prompt and the account so far, as JSON values.

        ``answers`` counts requests for an answer, ``problems`` those without a valid one by the exception's name, and
        ``seconds`` is the time spent waiting, summed over decisions.
        """
        return {
            "model": self._model,
            "prompt": self._prompt,
            "structured_output": self._structured,
            **self._totals,
            "seconds": self._seconds,
            "problems": dict(self._problems),
        }

    async def _decide(self, task: str, messages: list[dict[str, Any]]) -> np.ndarray | None:
        """Ask until an answer is valid, ``MOST_ANSWERS`` are not or the deadline has passed."""
        start, commands = time.monotonic(), None
        try:
            async with asyncio.timeout(self._timeout_s):
                for _ in range(MOST_ANSWERS):
                    try:
                        commands = await self._answer(task, messages)
                        break
                    except ReplyError as error:
                        self._note(task, error)
        except Exception as error:  # whatever a server provokes must not end an evaluation of hours
            self._note(task, error)
        self._totals["decisions"] += 1
        self._totals["failed"] += commands is None
        self._seconds += time.monotonic() - start
        return commands

    async def _answer(self, task: str, messages: list[dict[str, Any]]) -> np.ndarray:
        """Return the commands of one answer.

        Raises:
            ReplyError: if it is not in the requested format.
        """
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
        request: dict[str, Any] = {"model": self._model, "messages": messages, "max_tokens": MAX_TOKENS}
        if self._structured:
            schema = {"name": "hand_motion", "schema": Answer.model_json_schema()}
            try:
                return await create(**request, response_format={"type": "json_schema", "json_schema": schema})
            except (openai.BadRequestError, openai.UnprocessableEntityError):
                self._structured = False  # many servers offer none
        return await create(**request)

    def _note(self, task: str, error: Exception) -> None:
        """Count a problem; its words are told only if they are ours."""
        name = type(error).__name__
        self._problems[name] += 1
        self._write({"task": task, "problem": f"{name}: {error}" if isinstance(error, ReplyError) else name})

    def _write(self, line: dict[str, Any]) -> None:
        if self._log:
            with self._log.open("a") as stream:
                stream.write(json.dumps(line) + "\n")


def _connect(base_url: str | None) -> Any:
    """Return an `openai.AsyncOpenAI` client, unless the URL or the environment's key cannot be right."""
    key = os.environ.get("OPENAI_API_KEY", "").strip()
    if base_url is None and not key:
        raise ValueError("without --base-url the endpoint is OpenAI's and OPENAI_API_KEY must be set; it is not")
    if base_url is not None and not HTTP_URL.fullmatch(base_url):  # not repeated: results hold the command line
        raise ValueError("the base URL must be like http://localhost:8000/v1, without user name or password")
    return openai.AsyncOpenAI(api_key=key or "none", base_url=base_url)  # local servers check no key
