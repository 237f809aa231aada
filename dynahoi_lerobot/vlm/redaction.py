"""Removing the API key from everything that is stored or logged, also when a server sends it back."""

from __future__ import annotations

import base64
import logging
import re
from dataclasses import dataclass, field
from functools import cached_property

PLACEHOLDER = "[REDACTED]"
WIRE_LOGGERS = ("openai._base_client", "openai._legacy_response", "httpx2", "httpcore2.connection", "httpcore2.http11")
"""Loggers of the HTTP stack that print what a server sent."""


@dataclass(frozen=True)
class Redactor:
    """Replaces a secret by a placeholder.

    Found are plain copies in any letter case, copies with some or all characters percent-encoded or escaped as in JSON,
    Python or HTML, and hexadecimal and base64 copies, alone or within a longer encoded text.

    Attributes:
        secret: the API key, empty for none.
    """

    secret: str = field(repr=False)

    def __call__(self, text: str) -> str:
        """Return ``text`` without the secret."""
        return self._pattern.sub(PLACEHOLDER, text) if self._pattern else text

    def filter(self, record: logging.LogRecord) -> bool:
        """Redact a log record in place, as a `logging` filter; every record passes."""
        record.msg, record.args = self(record.getMessage()), ()
        return True

    def watch_loggers(self) -> None:
        """Redact the log records of the HTTP stack from now on; a second call changes nothing."""
        for name in WIRE_LOGGERS:
            logging.getLogger(name).addFilter(self)

    @cached_property
    def _pattern(self) -> re.Pattern[str] | None:
        if not self.secret:
            return None
        forms = ["".join(map(_any_escape, self.secret)), self.secret.encode().hex()]
        return re.compile("|".join([*forms, *_base64_forms(self.secret.encode())]), re.IGNORECASE)


def _any_escape(character: str) -> str:
    code = ord(character)
    # The look-behind and the possessive repeats keep the time linear for a megabyte of backslashes or zeros.
    escapes = rf"%(?:25)*{code:02x}|(?<!\\)\\++(?:u00|x){code:02x}|&\#(?:x0*+{code:x}|0*+{code});"
    return rf"(?:{re.escape(character)}|{escapes})"


def _base64_forms(secret: bytes) -> list[str]:
    """Return patterns for base64 text that contains ``secret``, one for each of its three alignments."""
    forms = []
    for shift in range(3):
        start, stop = (8 * shift + 5) // 6, 8 * (shift + len(secret)) // 6  # characters that the secret alone decides
        text = base64.b64encode(bytes(shift) + secret).decode()[start:stop]
        forms.append(re.escape(text).replace(r"\+", "[+-]").replace("/", "[/_]"))
    return forms
