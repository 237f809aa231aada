"""Asking an OpenAI-compatible endpoint, with bounds on time, size and retries, and an account of everything."""

from __future__ import annotations

import json
import os
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.vlm.prompt import HORIZON, answer_schema, messages
from dynahoi_lerobot.vlm.reply import ReplyError, parse_reply

KEY_VARIABLE = "OPENAI_API_KEY"
NO_KEY = "none"
"""Local servers ask for none."""
LARGEST_BODY = 1 << 20
MAX_TOKENS = 4096


@dataclass
class Account:
    """What the requests of a run came to.

    Attributes:
        decisions: chunks that were asked for.
        failed: decisions without any usable answer; the hand held still.
        requests: including retries.
        refused: answers that could not be played.
        errors: requests without an answer.
        prompt_tokens, completion_tokens: as the server counts them.
        cost: of the tokens, in the currency of the prices.
        seconds: spent waiting, summed over requests.
    """

    decisions: int = 0
    failed: int = 0
    requests: int = 0
    refused: int = 0
    errors: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    cost: float = 0.0
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
        audit: Path | None = None,
    ) -> None:
        """Connect to ``base_url`` (OpenAI's if None); the key comes from ``OPENAI_API_KEY`` alone.

        Args:
            model: its name at the endpoint.
            base_url: of the endpoint, ending in ``/v1`` as a rule.
            timeout_s: of one request.
            retries: further requests after an unusable answer or none.
            prices: of a million prompt and completion tokens.
            audit: a JSON-lines file to which every raw answer is appended.

        Raises:
            ValueError: if the endpoint is OpenAI's and there is no key, or the client is not installed.
        """
        self.account, self._prices, self._retries = Account(), prices, retries
        self._model, self._audit, self._lock = model, audit, threading.Lock()
        self._structured = True
        self._client = _connect(base_url, timeout_s)

    def plan(self, task: str, state: np.ndarray, image: np.ndarray) -> np.ndarray | None:
        """Return the (10, 18) commands that the model answers with, or None if no answer can be played.

        Args:
            task: the instruction.
            state: (18,) palm centre position [m] world and joint angles [rad].
            image: (H, W, 3) uint8 RGB.
        """
        request = messages(task, state, image)
        for _ in range(1 + self._retries):
            commands = self._ask(request, task)
            if commands is not None:
                break
        with self._lock:
            self.account.decisions += 1
            self.account.failed += commands is None
        return commands

    def report(self) -> dict[str, Any]:
        """Return the account so far, as JSON values."""
        with self._lock:
            return {"model": self._model, **asdict(self.account)}

    def _ask(self, request: list[dict[str, Any]], task: str) -> np.ndarray | None:
        import openai

        start, text, problem, commands, usage = time.monotonic(), None, "", None, None
        try:
            answer = self._complete(request)
            usage = answer.usage
            text = answer.choices[0].message.content if answer.choices else None
            commands = parse_reply(text)
        except ReplyError as error:
            problem = str(error)
        except (openai.OpenAIError, ValueError, AttributeError, TypeError) as error:
            problem = f"{type(error).__name__}: {error}"[:300]
        self._enter(task, text, problem, usage, time.monotonic() - start)
        return commands

    def _complete(self, request: list[dict[str, Any]]) -> Any:
        """Ask with structured output until the server refuses it, then without."""
        import openai

        options: dict[str, Any] = {"model": self._model, "messages": request, "max_tokens": MAX_TOKENS}
        if self._structured:
            schema = {"name": "hand_motion", "schema": answer_schema(HORIZON)}
            try:
                return self._client.chat.completions.create(
                    **options, response_format={"type": "json_schema", "json_schema": schema}
                )
            except (openai.BadRequestError, openai.UnprocessableEntityError):
                self._structured = False
        return self._client.chat.completions.create(**options)

    def _enter(self, task: str, text: str | None, problem: str, usage: Any, seconds: float) -> None:
        prompt = int(getattr(usage, "prompt_tokens", 0) or 0)
        completion = int(getattr(usage, "completion_tokens", 0) or 0)
        with self._lock:
            account = self.account
            account.requests += 1
            account.seconds += seconds
            account.refused += bool(problem) and text is not None
            account.errors += bool(problem) and text is None
            account.prompt_tokens += prompt
            account.completion_tokens += completion
            account.cost += (prompt * self._prices[0] + completion * self._prices[1]) / 1e6
            if self._audit:
                line = {"task": task, "seconds": round(seconds, 3), "problem": problem, "answer": text}
                with self._audit.open("a") as stream:
                    stream.write(json.dumps(line) + "\n")


def _connect(base_url: str | None, timeout_s: float) -> Any:
    try:
        import httpx2 as httpx
        import openai
    except ImportError as error:
        raise ValueError(f"a VLM needs the openai client ({error}); install dynahoi_lerobot[vlm]") from error
    from dynahoi_lerobot.vlm.bounded import BoundedTransport

    key = os.environ.get(KEY_VARIABLE)
    if base_url is None and not key:
        raise ValueError(f"without --base-url the endpoint is OpenAI's and {KEY_VARIABLE} must be set; it is not")
    transport = BoundedTransport(httpx.HTTPTransport(), max_bytes=LARGEST_BODY, max_s=timeout_s)
    return openai.OpenAI(
        api_key=key or NO_KEY,
        base_url=base_url,
        timeout=timeout_s,
        max_retries=0,
        http_client=httpx.Client(transport=transport, timeout=timeout_s),
    )
