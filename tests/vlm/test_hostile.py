"""Every hostile server costs at most one decision: it ends in time, is counted by its cause, and leaks no API key."""

from __future__ import annotations

import base64
import html
import json
import logging
import re
import time
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.vlm.client import Cause, VlmClient
from tests.vlm.hostile import FRAMES, GOOD, HOSTILE, KEY, SLOW, STATE, UNKNOWN_USAGE, answer, forms, in_turn
from tests.vlm.server import Exchange, serving

IMAGE = np.full((32, 32, 3), 200, np.uint8)
TIMEOUT_S = 0.5
SLACK_S = 1.0
"""Both long enough for a busy machine; without a deadline the slow servers take 3 to 5 s."""
LOGGED = {"task", "seconds", "cause", "problem", "status", "usage", "skills"}


@pytest.fixture(autouse=True)
def _key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


def leaks(text: str) -> bool:
    """Whether a text holds the key, or the beginning of it, in any of the encodings of `forms`."""
    plain = html.unescape(unquote(unquote(re.sub(r"\\+u00(..)", r"%\1", text)))).lower()
    codes = [base64.b64encode(bytes(i) + KEY.encode()).decode()[4:16].lower() for i in range(3)]
    return any(part in plain for part in (KEY[:7].lower(), KEY[:7].encode().hex(), *codes))


def test_a_leak_would_be_found():
    assert all(leaks(f"x{form}y") for form in forms(KEY).values())
    assert not leaks(answer())


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_server_costs_one_decision_at_most(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture
):
    handler, cause = HOSTILE[name]
    caplog.set_level(logging.DEBUG)
    timeout_s, log = TIMEOUT_S if name in SLOW else 20.0, tmp_path / "log.jsonl"
    with serving(handler) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=timeout_s, retries=1, log=log), time.monotonic()
        commands = client.plan("Catch it.", STATE, IMAGE)
        seconds = time.monotonic() - start
    assert seconds < timeout_s + SLACK_S
    report, lines = client.report(), [json.loads(line) for line in log.read_text().splitlines()]
    assert report["requests"] == len(seen) == len(lines)
    if cause is None:
        np.testing.assert_allclose(commands, np.tile(STATE, (FRAMES, 1)))
        assert (len(seen), report["failed"], report["failed_by"], report["failed_requests_by"]) == (1, 0, {}, {})
    else:
        assert commands is None
        assert (report["decisions"], report["failed"], report["failed_by"]) == (1, 1, {cause: 1})
        assert report["failed_requests_by"] == {cause: len(seen)}
        assert len(seen) == (1 if name in (*SLOW, "limits the rate") else 2)
        assert [(line["cause"], line["skills"]) for line in lines] == [(cause, None)] * len(seen)
    assert all(line.keys() == LOGGED and len(line["problem"]) < 300 for line in lines)
    assert not leaks(log.read_text() + json.dumps(report, allow_nan=False) + caplog.text + "".join(capfd.readouterr()))


@pytest.mark.parametrize("name", UNKNOWN_USAGE)
def test_senseless_token_counts_are_unknown(name: str):
    with serving(HOSTILE[f"counts {name} as tokens"][0]) as (url, _):
        client = VlmClient("tiny", url, prices=(1.0, 1.0))
        assert client.plan("", STATE, IMAGE) is not None
    account = client.account
    assert (account.prompt_tokens, account.completion_tokens, account.cost, account.unknown_usage) == (0, 0, 0.0, 1)


def test_one_deadline_covers_all_retries():
    def handler(exchange: Exchange) -> None:
        time.sleep(0.25)
        exchange.say("no")

    with serving(handler) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=0.6, retries=50), time.monotonic()
        assert client.plan("", STATE, IMAGE) is None
        assert time.monotonic() - start < 0.6 + SLACK_S
    assert client.account.requests == len(seen) <= 3
    assert client.account.failed_by == {"timeout": 1}


def test_a_server_that_refuses_structured_output_gets_no_more_time():
    def handler(exchange: Exchange) -> None:
        time.sleep(0.3)
        exchange.send({"error": "unsupported"}, 400)

    with serving(handler) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=0.4, retries=50), time.monotonic()
        assert client.plan("", STATE, IMAGE) is None
        assert time.monotonic() - start < 0.4 + SLACK_S
    assert len(seen) == 2


@pytest.mark.parametrize("headers", [[("Retry-After", "0.3")], []])
def test_a_busy_server_is_asked_again_after_the_pause_it_asks_for(headers: list):
    def handler(exchange: Exchange) -> None:
        if exchange.number == 0:
            exchange.raw(b"{}", 429, headers=headers)
        else:
            exchange.say(answer())

    with serving(handler) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=10.0), time.monotonic()
        assert client.plan("", STATE, IMAGE) is not None
        wait_s = 1.0  # of a fraction, which is no number of seconds in HTTP, and of nothing
        assert wait_s <= time.monotonic() - start < wait_s + SLACK_S
    assert len(seen) == 2


def test_a_pause_beyond_the_deadline_ends_the_decision_at_once():
    with serving(lambda exchange: exchange.raw(b"{}", 429, headers=[("Retry-After", "3600")])) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=5.0), time.monotonic()
        assert client.plan("", STATE, IMAGE) is None
        assert time.monotonic() - start < SLACK_S
    assert len(seen) == 1
    assert client.account.failed_by == {"http_4xx": 1}


def test_an_exception_of_the_client_library_is_a_failed_decision(monkeypatch: pytest.MonkeyPatch):
    def explode(*_: object, **__: object) -> None:
        raise KeyError(f"in the middle of {KEY}")

    monkeypatch.setattr("openai._base_client.AsyncAPIClient.post", explode)
    client = VlmClient("tiny", "http://127.0.0.1:9/v1", retries=0)
    assert client.plan("", STATE, IMAGE) is None
    assert client.report()["failed_by"] == {"unexpected": 1}


def test_a_log_file_that_cannot_be_written_is_counted(tmp_path: Path):
    with serving(lambda exchange: exchange.raw(GOOD)) as (url, _):
        client = VlmClient("tiny", url, log=tmp_path)  # a folder
        assert client.plan("", STATE, IMAGE) is not None
    assert client.account.unlogged == 1


def test_an_evaluation_survives_them_in_turn(tmp_path: Path, capsys: pytest.CaptureFixture):
    names = [name for name in HOSTILE if name not in SLOW][::4] + ["drips headers"]
    out = tmp_path / "results"
    with serving(in_turn(names)) as (url, seen):
        words = ["--policy", "vlm", "--model", "tiny", "--base-url", url, "--motions", "constant", "--out", str(out)]
        assert main(["evaluate", *words, "--episodes", "2", "--image-size", "32", "--request-timeout", "0.5"]) == 0
    assert len(seen) >= len(names)
    account = json.loads((out / "metrics.json").read_text())["extra"]["vlm"]
    assert account["failed"] == sum(account["failed_by"].values()) > 0
    assert account["requests"] == len((out / "vlm.jsonl").read_text().splitlines())
    assert set(account["failed_requests_by"]) <= set(Cause)
    written = [path.read_text(errors="replace") for path in out.rglob("*") if path.is_file()]
    assert not leaks("".join(written) + "".join(capsys.readouterr()))


@pytest.mark.parametrize(
    ("key", "url", "problem"),
    [
        ("sk secret", "http://h/v1", "contains a space"),
        ("sk-geheimß", "http://h/v1", "contains a space"),
        ("", None, "OPENAI_API_KEY must be set"),
        ("k", "http://user:secret@h/v1", "user name or password"),
        *(("k", url, "must be like") for url in ("localhost:8000", "ftp://h/v1", "http://", "http://h:port/v1", "")),
    ],
)
def test_a_key_or_address_that_cannot_be_is_refused_unseen(
    key: str, url: str | None, problem: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(ValueError, match=problem) as refused:
        VlmClient("tiny", url)
    assert not any(word in str(refused.value) for word in ("secret", "geheim"))
