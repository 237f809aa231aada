"""The API key is removed in every plain encoding, and nothing else is."""

from __future__ import annotations

import base64
import json
import logging
import random
import time
from urllib.parse import quote

import pytest

from dynahoi_lerobot.vlm.client import VlmClient
from dynahoi_lerobot.vlm.redaction import PLACEHOLDER, Redactor
from tests.vlm.hostile import KEY

redact = Redactor(KEY)


@pytest.mark.parametrize("around", [("", ""), ("Bearer ", "."), ('{"key": "', '"}'), (KEY, KEY)])
@pytest.mark.parametrize(
    "encode", [str, str.upper, quote, lambda key: quote(key, safe=""), lambda key: key.encode().hex()]
)
def test_the_key_is_replaced(encode, around: tuple[str, str]):
    before, after = around
    found = redact(before + encode(KEY) + after)
    assert found == before.replace(KEY, PLACEHOLDER) + PLACEHOLDER + after.replace(KEY, PLACEHOLDER)


@pytest.mark.parametrize("before", range(6))
@pytest.mark.parametrize("encode", [base64.b64encode, base64.urlsafe_b64encode])
def test_base64_at_any_offset(encode, before: int):
    text = encode(b"x" * before + KEY.encode() + b"yz").decode()
    assert PLACEHOLDER in redact(text)
    left = redact(text).replace(PLACEHOLDER, "")
    assert len(left) <= len(text) - len(KEY)


def test_other_text_stays():
    text = json.dumps({"key": KEY[:-1], "percent": "%41", "numbers": [0.1, -2e-3], "text": "sk-other"})
    assert redact(text) == text


def test_without_a_key_nothing_is_replaced():
    assert Redactor("")("abc x") == "abc x"


@pytest.mark.parametrize("key", ["x", "a+c"])
def test_a_key_too_short_to_be_told_from_other_text_is_refused_unseen(key: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(ValueError, match=f"OPENAI_API_KEY has {len(key)} characters; a key has 4 or more") as error:
        VlmClient("tiny", "http://127.0.0.1:9/v1")
    assert "a+c" not in str(error.value)


def test_the_representation_hides_the_key():
    assert KEY not in repr(redact)


def test_log_records_are_redacted_once(caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.DEBUG)
    logger = logging.getLogger("httpcore2.http11")
    Redactor(KEY).watch_loggers()
    filters = len(logger.filters)
    Redactor(KEY).watch_loggers()
    assert len(logger.filters) == filters
    logger.debug("received %r", [(b"X", KEY.encode())])
    assert caplog.messages == [f"received [(b'X', b'{PLACEHOLDER}')]"]


MEGABYTES = {
    "mixed": "".join(random.Random(0).choices("sk-VeryS%\\u&#0173", k=1 << 20)),
    "backslashes": "\\" * (1 << 20),
    "escaped backslashes": "\\u0073" * 170_000,
    "percent signs": "%25" * 350_000,
    "percent escapes": "%" + "25" * 500_000,
    "zeros": "&#" + "0" * (1 << 20),
    "numbered": "&#0" * 350_000,
    "beginnings": KEY[:-1] * 36_000,
    "base64": base64.b64encode(KEY.encode()).decode()[:-9] * 30_000,
}


@pytest.mark.parametrize("name", MEGABYTES)
def test_a_megabyte_is_redacted_quickly(name: str):
    start = time.perf_counter()
    redact(MEGABYTES[name])
    assert time.perf_counter() - start < 2.0  # 0.1 s as a rule; hours where the time is quadratic


@pytest.mark.parametrize("key", ["sk secret", "sk-\nsecret", "sk-geheimß"])
def test_a_key_that_no_header_can_hold_is_refused_unseen(key: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(ValueError, match="OPENAI_API_KEY contains a space") as error:
        VlmClient("tiny", "http://127.0.0.1:9/v1")
    assert "sk" not in str(error.value)


def test_white_space_around_the_key_is_ignored(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OPENAI_API_KEY", f" {KEY}\n")
    assert VlmClient("tiny", "http://127.0.0.1:9/v1")._redact == redact


@pytest.mark.parametrize("url", ["http://user:pass-word@h/v1", "https://pass-word@h/v1"])
def test_a_password_in_the_url_is_refused_unseen(url: str):
    with pytest.raises(ValueError, match="user name or password") as error:
        VlmClient("tiny", url)
    assert "pass-word" not in str(error.value)
