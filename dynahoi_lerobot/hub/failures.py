"""Errors of the Hub as one sentence that says what to do and never contains the token."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

RESUME = "nothing is lost; run the same command to resume"
LOG_IN = "create one that can write at https://huggingface.co/settings/tokens, then run `hf auth login` or set HF_TOKEN"
ANSWERS = {
    401: f"the Hub rejected the token; {LOG_IN}",
    403: f"the token has no write access there; {LOG_IN}",
    413: "the Hub rejected it as too large",
    429: f"the Hub limits the rate of requests; wait a few minutes: {RESUME}",
}
"""By HTTP status."""


class HubError(RuntimeError):
    """A request to the Hub failed; the message is one sentence."""


@contextmanager
def explained(repo: str, endpoint: str, token: str) -> Iterator[None]:
    """Turn the exceptions of the Hub's client into one sentence without the token.

    Raises:
        HubError: instead of it.
    """
    try:
        yield
    except HubError:
        raise
    except Exception as error:
        sentence = f"{repo}: {_sentence(error, endpoint)}"
        raise HubError(sentence.replace(token, "[token]") if token else sentence) from None


def _sentence(error: Exception, endpoint: str) -> str:
    import httpx
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled

    for cause in _causes(error):
        if isinstance(cause, HfHubHTTPError):
            status = cause.response.status_code
            said = " ".join((cause.server_message or "no reason").split())
            return ANSWERS.get(status, f"the Hub answered {status} ({said}); {RESUME}")
        if isinstance(cause, httpx.TransportError | OfflineModeIsEnabled):
            return f"cannot reach {endpoint} ({type(cause).__name__}); {RESUME}"
    reason = " ".join(str(error).split())
    return f"the upload failed ({type(error).__name__}: {reason}); {RESUME}"


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
