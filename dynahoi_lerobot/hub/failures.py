"""What goes wrong with the Hub, as one sentence that says what to do; the token is in none of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dynahoi_lerobot.vlm.redaction import Redactor

RESUME = "nothing is lost, and the same command goes on from here"
LOG_IN = "make one that may write at https://huggingface.co/settings/tokens, then run `hf auth login` or set HF_TOKEN"
ANSWERS = {
    401: f"the Hub refuses the token; {LOG_IN}",
    403: f"the token may not write there; {LOG_IN}",
    413: "the Hub says that it is too large",
    429: f"the Hub asks for a pause; wait a few minutes: {RESUME}",
}
"""By HTTP status."""


class HubError(RuntimeError):
    """The Hub could not be used; the message is one sentence."""


@contextmanager
def explained(repo: str, endpoint: str, token: str) -> Iterator[None]:
    """Turn whatever the Hub's client raises into one sentence without the token.

    Raises:
        HubError: instead of it.
    """
    try:
        yield
    except HubError:
        raise
    except Exception as error:
        raise HubError(Redactor(token)(f"{repo}: {_sentence(error, endpoint)}")) from None


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
    return f"the upload stopped ({type(error).__name__}: {reason}); {RESUME}"


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
