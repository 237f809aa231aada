"""Reading a chat completion, field by field, from a server that is not trusted."""

from __future__ import annotations

from typing import Any, TypeGuard

from dynahoi_lerobot.vlm.bounded_json import decode_json
from dynahoi_lerobot.vlm.failures import Cause, RequestFailure

MAX_TOKEN_COUNT = 10**9
"""A larger count for one request is not believed."""

Usage = tuple[int, int]
"""Prompt and completion tokens of one request."""


def read_envelope(body: str) -> dict[str, Any]:
    """Return the JSON object of a response body.

    Raises:
        RequestFailure: with cause `Cause.MALFORMED` if it is not one.
    """
    try:
        envelope = decode_json(body)
    except ValueError as error:
        raise _malformed(f"not JSON ({error})") from None
    if not isinstance(envelope, dict):
        raise _malformed(f"a JSON {type(envelope).__name__}, not an object")
    return envelope


def read_usage(envelope: dict[str, Any]) -> Usage | None:
    """Return what the server counted; None unless both counts are integers from 0 to `MAX_TOKEN_COUNT`."""
    usage = envelope.get("usage")
    if not isinstance(usage, dict):
        return None
    prompt, completion = usage.get("prompt_tokens"), usage.get("completion_tokens")
    return (prompt, completion) if _is_count(prompt) and _is_count(completion) else None


def read_text(envelope: dict[str, Any]) -> str:
    """Return the text of the first choice.

    Raises:
        RequestFailure: with cause `Cause.MALFORMED` if there is none.
    """
    choices = envelope.get("choices")
    choice = choices[0] if isinstance(choices, list) and choices else None
    message = choice.get("message") if isinstance(choice, dict) else None
    text = message.get("content") if isinstance(message, dict) else None
    if not isinstance(text, str):
        raise _malformed("no text in choices[0].message.content")
    return text


def _is_count(value: Any) -> TypeGuard[int]:
    return type(value) is int and 0 <= value <= MAX_TOKEN_COUNT


def _malformed(what: str) -> RequestFailure:
    return RequestFailure(Cause.MALFORMED, f"the response is no chat completion: {what}")
