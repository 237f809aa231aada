"""The address of the endpoint, its API key, and the connection to it."""

from __future__ import annotations

import os
from typing import Any
from urllib.parse import urlsplit

from dynahoi_lerobot.vlm.redaction import Redactor

KEY_VARIABLE = "OPENAI_API_KEY"
URL_VARIABLE = "OPENAI_BASE_URL"
NO_KEY = "none"
"""Sent where no key is set; local servers check none."""
MIN_KEY_LENGTH = 4
"""A shorter key cannot be told from other text, so that it could not be kept out of what is stored."""


def api_key(base_url: str | None) -> str:
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


def connect(base_url: str | None, redact: Redactor) -> Any:
    """Return an `openai.OpenAI` client that sends through a `BoundedTransport`, without retries of its own.

    Raises:
        ValueError: if the ``openai`` package is not installed, or ``base_url`` is not an HTTP URL without credentials.
    """
    try:
        import httpx2 as httpx
        import openai
    except ImportError as error:
        raise ValueError(f"a VLM needs the openai client ({error}), which the extra `vlm` installs") from error
    from dynahoi_lerobot.vlm.transport import BoundedTransport

    _check_url(os.environ.get(URL_VARIABLE) or None if base_url is None else base_url, redact)
    return openai.OpenAI(
        api_key=redact.secret or NO_KEY,
        base_url=base_url,
        max_retries=0,
        http_client=httpx.Client(transport=BoundedTransport(redact), follow_redirects=False),
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
