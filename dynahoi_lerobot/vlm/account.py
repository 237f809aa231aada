"""The account of a run: requests, failures by cause, tokens and cost."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


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

    @classmethod
    def of_status(cls, status: int) -> Cause:
        """Return the cause for an HTTP status code that is not 2xx."""
        return {3: cls.HTTP_3XX, 4: cls.HTTP_4XX, 5: cls.HTTP_5XX}.get(status // 100, cls.HTTP_OTHER)


Usage = tuple[int, int]
"""Prompt and completion tokens of one request."""


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

    def add_request(self, cause: str | None, usage: Usage | None, prices: tuple[float, float], seconds: float) -> None:
        """Count one request.

        Args:
            cause: of its failure, None if the answer is valid.
            usage: prompt and completion tokens, None if unknown.
            prices: of a million prompt and completion tokens.
            seconds: it took [s].
        """
        self.requests += 1
        self.seconds += seconds
        self.unknown_usage += usage is None
        prompt, completion = usage or (0, 0)
        self.prompt_tokens += prompt
        self.completion_tokens += completion
        self.cost += (prompt * prices[0] + completion * prices[1]) / 1e6
        if cause is not None:
            self.failed_requests_by[str(cause)] += 1

    def add_decision(self, cause: str | None) -> None:
        """Count one decision; ``cause`` is that of its failure, None if it gave commands."""
        self.decisions += 1
        if cause is not None:
            self.failed += 1
            self.failed_by[str(cause)] += 1

    def report(self) -> dict[str, Any]:
        """Return the totals as JSON values."""
        return {name: dict(v) if isinstance(v, Counter) else v for name, v in vars(self).items()}
