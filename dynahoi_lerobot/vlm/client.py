"""A client for an OpenAI-compatible endpoint, with one deadline per decision and an account of its requests.

A server may answer anything, the API key in any encoding included. So nothing that it says is stored or logged but what
``reply`` has read of a valid answer, and token counts.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, Prompt

MAX_TOKENS = 4096
MAX_TOKEN_COUNT = 10**9
"""A larger count for one request is not believed."""
FORMAT_REFUSED = (400, 422)
"""HTTP status codes with which servers refuse structured output."""
BUSY = 429
"""HTTP status code with which servers ask for a pause."""
BUSY_PAUSE_S = 1.0
"""Pause [s] where the server does not say how long; it doubles with each retry."""
KEY_VARIABLE, URL_VARIABLE = "OPENAI_API_KEY", "OPENAI_BASE_URL"
NO_KEY = "none"
"""Sent where no key is set; local servers check none."""
WIRE_LOGGERS = ("openai", "httpx", "httpx2", "httpcore", "httpcore2")
"""Loggers that print what a server sent, at level DEBUG."""


class Cause(StrEnum):
    """Why a request gave no commands: a fixed set, so that no server can add keys to a report."""

    TIMEOUT = "timeout"
    """The deadline of the decision passed."""
    CONNECTION = "connection"
    """Name resolution, TCP or TLS failed, the connection broke, or the response is not HTTP."""
    HTTP_3XX = "http_3xx"
    """A redirect; none is followed."""
    HTTP_4XX = "http_4xx"
    HTTP_5XX = "http_5xx"
    HTTP_OTHER = "http_other"
    MALFORMED = "malformed"
    """The response body is not JSON, or not a chat completion with text."""
    UNPLAYABLE = "unplayable"
    """A chat completion whose text is not a valid answer."""
    UNEXPECTED = "unexpected"
    """Any other exception during a request."""


@dataclass
class Account:
    """Totals over the requests of a run.

    Attributes:
        decisions: action chunks that were asked for.
        failed: decisions without a valid answer, for which the hand held its pose.
        failed_by: those, by the cause of the last request.
        requests: HTTP requests, retries included.
        failed_requests_by: requests without a valid answer, by cause.
        prompt_tokens: counted by the server, over the requests whose usage is known.
        completion_tokens: likewise.
        unknown_usage: requests for which the server gave no valid token counts.
        cost: of the known tokens, in the currency of the prices.
        seconds: time spent waiting [s], summed over requests.
        unlogged: requests that could not be written to the log file.
    """

    decisions: int = 0
    failed: int = 0
    failed_by: Counter[str] = field(default_factory=Counter)
    requests: int = 0
    failed_requests_by: Counter[str] = field(default_factory=Counter)
    prompt_tokens: int = 0
    completion_tokens: int = 0
    unknown_usage: int = 0
    cost: float = 0.0
    seconds: float = 0.0
    unlogged: int = 0


@dataclass
class _Attempt:
    """One request: the commands and skills if its answer is valid, else the cause and, in our words, the problem."""

    commands: np.ndarray | None = None
    skills: list[tuple[str, int]] | None = None
    cause: Cause | None = None
    problem: str = ""
    status: int | None = None
    retry_after_s: float | None = None
    usage: tuple[int, int] | None = None
    seconds: float = 0.0


class VlmClient:
    """One model behind one endpoint; safe to use from several threads.

    Requests run in an event loop on a thread of their own: cancelling a request there ends it wherever it waits, while
    the timeouts of an HTTP client restart with every byte.
    """

    def __init__(
        self,
        model: str,
        base_url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 2,
        prices: tuple[float, float] = (0.0, 0.0),
        prompt: Prompt = DEFAULT_PROMPT,
        log: Path | None = None,
    ) -> None:
        """Prepare requests to ``base_url``; the API key is read from the environment variable ``OPENAI_API_KEY``.

        Args:
            model: its name at the endpoint.
            base_url: of the endpoint, usually ending in ``/v1``; None is OpenAI's.
            timeout_s: for one decision [s], all its requests included.
            retries: further requests after a failed one, as long as time is left.
            prices: of a million prompt and completion tokens, in any currency.
            prompt: what is asked.
            log: a JSON-lines file to which a line is appended for every request.

        Raises:
            ValueError: for an invalid URL or key, if the endpoint is OpenAI's and there is no key, or if the ``openai``
                package is not installed.
        """
        self.account, self._prices, self._retries = Account(), prices, retries
        self._model, self._log, self._lock = model, log, threading.Lock()
        self._prompt, self._timeout_s, self._structured = prompt, timeout_s, True
        self._client = _connect(base_url)
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True, name="vlm").start()

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
        messages = self._prompt.messages(task, state, image)
        attempt = asyncio.run_coroutine_threadsafe(self._decide(messages, task), self._loop).result()
        with self._lock:
            self.account.decisions += 1
            if attempt.cause:
                self.account.failed += 1
                self.account.failed_by[attempt.cause] += 1
        return attempt.commands

    def report(self) -> dict[str, Any]:
        """Return the names of model and prompt and the account so far, as JSON values."""
        with self._lock:
            asked = {"model": self._model, "prompt": self._prompt.name, "structured_output": self._structured}
            totals = {name: dict(v) if isinstance(v, Counter) else v for name, v in vars(self.account).items()}
            return asked | totals

    async def _decide(self, messages: list[dict[str, Any]], task: str) -> _Attempt:
        """Ask until an answer is valid, no retry is left or the deadline has passed; return the last attempt.

        A server that is busy is given the pause it asks for, or no further request if that outlasts the deadline.
        """
        end, left, pause_s = self._loop.time() + self._timeout_s, 1 + self._retries, BUSY_PAUSE_S
        while True:
            structured = self._structured
            attempt = await self._ask(messages, end, structured)
            self._record(task, attempt)
            if structured and attempt.status in FORMAT_REFUSED:
                self._structured = False  # many servers offer none; this does not count as a retry
            else:
                left -= 1
            if attempt.commands is not None or left == 0 or self._loop.time() >= end:
                return attempt
            if attempt.status == BUSY:
                wait_s = pause_s if attempt.retry_after_s is None else attempt.retry_after_s
                if wait_s >= end - self._loop.time():
                    return attempt
                await asyncio.sleep(wait_s)
                pause_s *= 2

    async def _ask(self, messages: list[dict[str, Any]], end: float, structured: bool) -> _Attempt:
        """Send one request, which is over at ``end`` [s] of the loop's clock."""
        import openai

        from dynahoi_lerobot.vlm.reply import ReplyError, parse_reply

        attempt, start = _Attempt(), time.monotonic()
        try:
            async with asyncio.timeout_at(end):
                completion = await self._post(messages, structured)
            attempt.usage = _usage(completion)
            attempt.commands, attempt.skills = parse_reply(_text(completion))
        except (TimeoutError, openai.APITimeoutError):
            attempt.cause = Cause.TIMEOUT
        except openai.APIStatusError as error:
            hundreds, attempt.status = error.status_code // 100, error.status_code
            attempt.cause = Cause(f"http_{hundreds}xx") if hundreds in (3, 4, 5) else Cause.HTTP_OTHER
            attempt.retry_after_s = _retry_after_s(error.response.headers.get("retry-after", ""))
        except openai.APIConnectionError:
            attempt.cause = Cause.CONNECTION
        except ReplyError as error:
            attempt.cause, attempt.problem = Cause.UNPLAYABLE, str(error)
        except (ValueError, RecursionError, openai.APIResponseValidationError):
            attempt.cause = Cause.MALFORMED
        except Exception:  # whatever a server provokes must not end an evaluation of hours
            attempt.cause = Cause.UNEXPECTED
        attempt.seconds = time.monotonic() - start
        return attempt

    async def _post(self, messages: list[dict[str, Any]], structured: bool) -> Any:
        from dynahoi_lerobot.vlm.reply import Answer

        options: dict[str, Any] = {}
        if structured:
            schema = {"name": "hand_motion", "schema": Answer.model_json_schema()}
            options["response_format"] = {"type": "json_schema", "json_schema": schema}
        return await self._client.chat.completions.create(
            model=self._model, messages=messages, max_tokens=MAX_TOKENS, timeout=self._timeout_s, **options
        )

    def _record(self, task: str, attempt: _Attempt) -> None:
        """Count a request and append it to the log file; a full disk must not end an evaluation."""
        line = {
            "task": task,
            "seconds": round(attempt.seconds, 3),
            "cause": attempt.cause,
            "problem": attempt.problem,
            "status": attempt.status,
            "usage": attempt.usage,
            "skills": attempt.skills,
        }
        tokens, account = attempt.usage or (0, 0), self.account
        with self._lock:
            account.requests += 1
            account.seconds += attempt.seconds
            account.unknown_usage += attempt.usage is None
            account.prompt_tokens += tokens[0]
            account.completion_tokens += tokens[1]
            account.cost += float(np.dot(tokens, self._prices)) / 1e6
            if attempt.cause:
                account.failed_requests_by[attempt.cause] += 1
            try:
                if self._log:
                    with self._log.open("a") as stream:
                        stream.write(json.dumps(line) + "\n")
            except OSError:
                account.unlogged += 1


def _usage(completion: Any) -> tuple[int, int] | None:
    """Return the tokens of prompt and answer; None unless both are integers from 0 to ``MAX_TOKEN_COUNT``."""
    usage = getattr(completion, "usage", None)
    prompt, answered = (getattr(usage, name, None) for name in ("prompt_tokens", "completion_tokens"))
    counts = all(type(count) is int and 0 <= count <= MAX_TOKEN_COUNT for count in (prompt, answered))
    return (prompt, answered) if counts else None  # type: ignore[return-value]


def _text(completion: Any) -> str:
    """Return the text of the first choice; the client library passes on whatever a server sends in its place.

    Raises:
        ValueError: if there is none.
    """
    try:
        text = completion.choices[0].message.content
    except (AttributeError, IndexError, KeyError, TypeError):
        text = None
    if not isinstance(text, str):
        raise ValueError("no text in choices[0].message.content")
    return text


def _retry_after_s(header: str) -> float | None:
    """Return the seconds of a ``Retry-After`` header; None for a date or anything else."""
    return float(header) if header.isdecimal() and len(header) <= 6 else None


def _connect(base_url: str | None) -> Any:
    """Return an `openai.AsyncOpenAI` client without retries of its own, which follows no redirect.

    Raises:
        ValueError: if the ``openai`` package is not installed, ``base_url`` is not an HTTP URL without credentials, or
            the key is missing for OpenAI's endpoint or cannot stand in a header.
    """
    try:
        import openai
    except ImportError as error:
        raise ValueError(f"a VLM needs the openai client ({error}), which the extra `vlm` installs") from error
    for name in WIRE_LOGGERS:
        logging.getLogger(name).setLevel(logging.WARNING)
    url, key = base_url, os.environ.get(KEY_VARIABLE, "").strip()
    if url is None and not key:
        raise ValueError(f"without --base-url the endpoint is OpenAI's and {KEY_VARIABLE} must be set; it is not")
    if not all("!" <= character <= "~" for character in key):
        raise ValueError(f"{KEY_VARIABLE} contains a space or a character that is not printable ASCII")
    if (url := os.environ.get(URL_VARIABLE) or None if url is None else url) is not None:
        _check_url(url)
    return openai.AsyncOpenAI(
        api_key=key or NO_KEY,
        base_url=base_url,
        max_retries=0,
        default_headers={"Connection": "close"},  # a server that drops one request must not fail the next
        http_client=openai.DefaultAsyncHttpxClient(follow_redirects=False),
    )


def _check_url(url: str) -> None:
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:  # of a port that is no number, or an unclosed bracket
        parts, valid = None, False
    if parts and "@" in parts.netloc:
        raise ValueError(f"the base URL contains a user name or password; set {KEY_VARIABLE} instead")
    if not valid:
        raise ValueError(f"the base URL is {url!r}; it must be like http://localhost:8000/v1")
