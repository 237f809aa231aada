"""A client for an OpenAI-compatible endpoint, with one deadline per decision and an account of its requests."""

from __future__ import annotations

import asyncio
import json
import math
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from dynahoi_lerobot.vlm.account import Account, Cause, Usage
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, Prompt
from dynahoi_lerobot.vlm.redaction import Redactor

MAX_TOKENS = 4096
MAX_TOKEN_COUNT = 10**9
"""A larger count for one request is not believed."""
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
KEY_VARIABLE = "OPENAI_API_KEY"
URL_VARIABLE = "OPENAI_BASE_URL"
NO_KEY = "none"
"""Sent where no key is set; local servers check none."""
MIN_KEY_LENGTH = 4
"""A shorter key cannot be told from other text, so that it could not be kept out of what is stored."""


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
        self._redact = Redactor(_api_key(base_url))
        self._redact.watch_loggers()
        self._client = _connect(base_url, self._redact)
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
            self.account.add_decision(attempt.cause)
        return attempt.commands

    def report(self) -> dict[str, Any]:
        """Return the names of model and prompt and the account so far, as JSON values."""
        with self._lock:
            asked = {"model": self._redact(self._model), "prompt": self._prompt.name}
            return {**asked, "structured_output": self._structured, **self.account.report()}

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
            attempt.usage, attempt.text = _usage(completion), _text(completion)
            attempt.commands = parse_reply(attempt.text)
        except (TimeoutError, openai.APITimeoutError):
            attempt.cause, attempt.problem = Cause.TIMEOUT, f"no complete answer within {self._timeout_s:.3g} s"
        except openai.APIStatusError as error:
            attempt.cause, attempt.problem, attempt.status = (
                Cause.of_status(error.status_code),
                str(error),
                error.status_code,
            )
            attempt.retry_after_s = _retry_after_s(error.response.headers.get("retry-after", ""))
        except openai.APIConnectionError as error:
            attempt.cause, attempt.problem = Cause.CONNECTION, f"{error} {error.__cause__ or ''}"
        except ReplyError as error:
            attempt.cause, attempt.problem = Cause.UNPLAYABLE, str(error)
        except (ValueError, RecursionError, openai.APIResponseValidationError) as error:
            attempt.cause, attempt.problem = Cause.MALFORMED, f"the response is no chat completion: {error}"
        except Exception as error:  # whatever a server provokes must not end an evaluation of hours
            attempt.cause, attempt.problem = Cause.UNEXPECTED, f"{type(error).__name__}: {error}"
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


def _usage(completion: Any) -> Usage | None:
    """Return what the server counted; None unless both counts are integers from 0 to ``MAX_TOKEN_COUNT``."""
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


def _api_key(base_url: str | None) -> str:
    """Return the API key from the environment, empty if none is set.

    Raises:
        ValueError: if the endpoint is OpenAI's and there is no key, if the key cannot stand in an HTTP header, or if it
            is too short to be redacted.
    """
    key = os.environ.get(KEY_VARIABLE, "").strip()
    if base_url is None and not key:
        raise ValueError(f"without --base-url the endpoint is OpenAI's and {KEY_VARIABLE} must be set; it is not")
    if not all("!" <= character <= "~" for character in key):
        raise ValueError(f"{KEY_VARIABLE} contains a space or a character that is not printable ASCII")
    if 0 < len(key) < MIN_KEY_LENGTH:
        raise ValueError(
            f"{KEY_VARIABLE} has {len(key)} characters; a key has {MIN_KEY_LENGTH} or more, and a server that checks "
            "none needs none"
        )
    return key


def _connect(base_url: str | None, redact: Redactor) -> Any:
    """Return an `openai.AsyncOpenAI` client without retries of its own, which follows no redirect.

    Raises:
        ValueError: if the ``openai`` package is not installed, or ``base_url`` is not an HTTP URL without credentials.
    """
    try:
        import openai
    except ImportError as error:
        raise ValueError(f"a VLM needs the openai client ({error}), which the extra `vlm` installs") from error
    _check_url(os.environ.get(URL_VARIABLE) or None if base_url is None else base_url, redact)
    return openai.AsyncOpenAI(
        api_key=redact.secret or NO_KEY,
        base_url=base_url,
        max_retries=0,
        default_headers={"Connection": "close"},  # a server that drops one request must not fail the next
        http_client=openai.DefaultAsyncHttpxClient(follow_redirects=False),
    )


def _check_url(url: str | None, redact: Redactor) -> None:
    if url is None:
        return
    try:
        parts = urlsplit(url)
        valid, credentials = (
            parts.scheme in ("http", "https") and parts.hostname and parts.port != 0,
            "@" in parts.netloc,
        )
    except ValueError:  # of a port that is no number, or an unclosed bracket
        valid, credentials = False, False
    if credentials:
        raise ValueError(f"the base URL contains a user name or password; set {KEY_VARIABLE} instead")
    if not valid:
        raise ValueError(f"the base URL is {redact(url)!r}; it must be like http://localhost:8000/v1")


def _check_numbers(timeout_s: float, retries: int, prices: tuple[float, float]) -> None:
    if not 0 < timeout_s <= MAX_TIMEOUT_S:
        raise ValueError(f"the timeout is {timeout_s} s; it must be above 0 and at most {MAX_TIMEOUT_S:.0f} s")
    if retries < 0:
        raise ValueError(f"the number of retries is {retries}; it must not be negative")
    for price in prices:
        if not (math.isfinite(price) and 0 <= price <= MAX_PRICE):
            raise ValueError(f"the price of a million tokens is {price}; it must be from 0 to {MAX_PRICE:.0f}")
