"""Why a request to the endpoint gave no commands; the report counts requests and decisions by these causes."""

from __future__ import annotations

from enum import StrEnum


class Cause(StrEnum):
    """The fixed set of causes, so that no server can add keys to a report."""

    TIMEOUT = "timeout"
    """The deadline of the decision passed."""
    CONNECTION = "connection"
    """Name resolution, TCP or TLS failed, or the connection broke."""
    TOO_LARGE = "too_large"
    """The response head, or the response body as sent or decompressed, exceeds its limit."""
    HTTP_3XX = "http_3xx"
    """A redirect; none is followed."""
    HTTP_4XX = "http_4xx"
    HTTP_5XX = "http_5xx"
    HTTP_OTHER = "http_other"
    MALFORMED = "malformed"
    """Not HTTP, not JSON, or not a chat completion with text."""
    UNPLAYABLE = "unplayable"
    """A chat completion whose text is not a valid answer."""
    UNEXPECTED = "unexpected"
    """Any other exception during a request."""

    @classmethod
    def of_status(cls, status: int) -> Cause:
        """Return the cause for an HTTP status code that is not 2xx."""
        return {3: cls.HTTP_3XX, 4: cls.HTTP_4XX, 5: cls.HTTP_5XX}.get(status // 100, cls.HTTP_OTHER)


class RequestFailure(Exception):  # noqa: N818 - "Error" would suggest that it leaves the client
    """One request gave no commands.

    Attributes:
        cause: its category.
        status: HTTP status code of the response, None if there was no complete one.
        retry_after_s: how long the server asks to wait before the next request [s], None if it does not say.
    """

    def __init__(
        self, cause: Cause, message: str, status: int | None = None, retry_after_s: float | None = None
    ) -> None:
        super().__init__(message)
        self.cause, self.status, self.retry_after_s = cause, status, retry_after_s
