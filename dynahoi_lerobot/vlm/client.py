"""A client for an OpenAI-compatible endpoint, bounded in time and size, with an account of its requests."""

from __future__ import annotations

import json
import math
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.vlm.account import Account
from dynahoi_lerobot.vlm.completion import Usage, read_envelope, read_text, read_usage
from dynahoi_lerobot.vlm.deadline import Deadline
from dynahoi_lerobot.vlm.endpoint import api_key, connect
from dynahoi_lerobot.vlm.failures import Cause, RequestFailure
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, HORIZON, Prompt, answer_schema
from dynahoi_lerobot.vlm.redaction import Redactor
from dynahoi_lerobot.vlm.reply import parse_reply

MAX_TOKENS = 4096
MAX_TIMEOUT_S = 86_400.0
MAX_PRICE = 1e6
MAX_LOGGED = 16_384
"""Characters of an answer that are written to the log file."""
FORMAT_REFUSED = (400, 422)
"""HTTP status codes with which servers refuse structured output."""
BUSY = 429
"""HTTP status code with which servers ask for a pause."""
BUSY_PAUSE_S = 1.0
"""Pause [s] where the server does not say how long; it doubles with each retry."""


@dataclass
class _Attempt:
    """One request: the commands if its answer is valid, else the cause and what was wrong."""

    commands: np.ndarray | None = None
    cause: Cause | None = None
    problem: str = ""
    status: int | None = None
    retry_after_s: float | None = None
    text: str | None = None
    usage: Usage | None = None
    seconds: float = 0.0


class VlmClient:
    """One model behind one endpoint; safe to use from several threads."""

    def __init__(
        self,
        model: str,
        base_url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        prices: tuple[float, float] = (0.0, 0.0),
        prompt: Prompt = DEFAULT_PROMPT,
        audit: Path | None = None,
    ) -> None:
        """Prepare requests to ``base_url``; the API key is read from the environment variable ``OPENAI_API_KEY``.

        Args:
            model: its name at the endpoint.
            base_url: of the endpoint, usually ending in ``/v1``; None is OpenAI's.
            timeout_s: for one decision [s], all its requests included.
            retries: further requests after a failed one, as long as time is left.
            prices: of a million prompt and completion tokens, in any currency.
            prompt: what is asked.
            audit: a JSON-lines file to which a line is appended for every request, with the text of the answer.

        Raises:
            ValueError: for a number out of range, an invalid URL or key, if the endpoint is
                OpenAI's and there is no key, or if the ``openai`` package is not installed.
        """
        _check_numbers(timeout_s, retries, prices)
        self.account, self._prices, self._retries = Account(), prices, retries
        self._model, self._audit, self._lock = model, audit, threading.Lock()
        self._prompt, self._timeout_s, self._structured = prompt, timeout_s, True
        self._redact = Redactor(api_key(base_url))
        self._redact.watch_loggers()
        self._client = connect(base_url, self._redact)

    def plan(self, task: str, state: np.ndarray, image: np.ndarray) -> np.ndarray | None:
        """Return the commands for the next frames, or None if the server gives no valid answer in time.

        Nothing that a server does raises an exception here; the failure is counted by its cause.

        Args:
            task: the instruction.
            state: (18,) palm centre position [m], home frame, and joint angles [rad].
            image: (H, W, 3) uint8 RGB of the hand's camera.

        Returns:
            (10, 18) palm centre position [m], home frame, and joint angles [rad], one row for each frame of 0.05 s.
        """
        attempt = self._attempts(self._prompt.messages(task, state, image), task)
        with self._lock:
            self.account.add_decision(attempt.cause)
        return attempt.commands

    def report(self) -> dict[str, Any]:
        """Return the names of model and prompt and the account so far, as JSON values."""
        with self._lock:
            asked = {"model": self._redact(self._model), "prompt": self._prompt.name}
            return {**asked, "structured_output": self._structured, **self.account.report()}

    def _attempts(self, request: list[dict[str, Any]], task: str) -> _Attempt:
        """Ask until an answer is valid, no retry is left or the deadline has passed; return the last attempt.

        A server that is busy is given the pause it asks for, or no further request if that outlasts the deadline.
        """
        deadline, left, pause_s = Deadline(self._timeout_s), 1 + self._retries, BUSY_PAUSE_S
        while True:
            structured = self._structured
            attempt = self._ask(request, deadline, structured)
            self._record(task, attempt)
            if structured and attempt.status in FORMAT_REFUSED:
                self._structured = False  # many servers offer none; this does not count as a retry
            else:
                left -= 1
            if attempt.commands is not None or left == 0 or deadline.passed:
                return attempt
            if attempt.status == BUSY:
                wait_s = pause_s if attempt.retry_after_s is None else attempt.retry_after_s
                if not deadline.pause(wait_s):
                    return attempt
                pause_s *= 2

    def _ask(self, request: list[dict[str, Any]], deadline: Deadline, structured: bool) -> _Attempt:
        attempt, start = _Attempt(), time.monotonic()
        try:
            envelope = read_envelope(self._post(request, deadline, structured))
            attempt.usage = read_usage(envelope)
            attempt.text = read_text(envelope)
            attempt.commands = parse_reply(attempt.text)
        except RequestFailure as failure:
            attempt.cause, attempt.problem, attempt.status = failure.cause, str(failure), failure.status
            attempt.retry_after_s = failure.retry_after_s
        except Exception as error:  # whatever a server provokes must not end an evaluation of hours
            attempt.cause, attempt.problem = Cause.UNEXPECTED, f"{type(error).__name__}: {error}"
        attempt.seconds = time.monotonic() - start
        return attempt

    def _post(self, request: list[dict[str, Any]], deadline: Deadline, structured: bool) -> str:
        options: dict[str, Any] = {"model": self._model, "messages": request, "max_tokens": MAX_TOKENS}
        if structured:
            schema = {"name": "hand_motion", "schema": answer_schema(HORIZON)}
            options["response_format"] = {"type": "json_schema", "json_schema": schema}
        create = self._client.chat.completions.with_raw_response.create  # the body is parsed in completion.py
        return create(**options, timeout=deadline.remaining()).http_response.text

    def _record(self, task: str, attempt: _Attempt) -> None:
        line = {
            "task": self._redact(task),
            "seconds": round(attempt.seconds, 3),
            "cause": attempt.cause,
            "problem": self._redact(attempt.problem)[:300],
            "usage": attempt.usage,
            "answer": attempt.text and self._redact(attempt.text)[:MAX_LOGGED],
        }
        with self._lock:
            self.account.add_request(attempt.cause, attempt.usage, self._prices, attempt.seconds)
            self.account.unlogged += not self._log(json.dumps(line))

    def _log(self, line: str) -> bool:
        """Append a line to the log file; return whether that worked, as a full disk must not end an evaluation."""
        try:
            if self._audit:
                with self._audit.open("a") as stream:
                    stream.write(line + "\n")
        except OSError:
            return False
        return True


def _check_numbers(timeout_s: float, retries: int, prices: tuple[float, float]) -> None:
    if not 0 < timeout_s <= MAX_TIMEOUT_S:
        raise ValueError(f"the timeout is {timeout_s} s; it must be above 0 and at most {MAX_TIMEOUT_S:.0f} s")
    if retries < 0:
        raise ValueError(f"the number of retries is {retries}; it must not be negative")
    for price in prices:
        if not (math.isfinite(price) and 0 <= price <= MAX_PRICE):
            raise ValueError(f"the price of a million tokens is {price}; it must be from 0 to {MAX_PRICE:.0f}")
