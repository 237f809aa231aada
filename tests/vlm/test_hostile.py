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
from dynahoi_lerobot.vlm.account import Cause
from dynahoi_lerobot.vlm.client import VlmClient
from dynahoi_lerobot.vlm.redaction import Redactor
from tests.vlm.hostile import FRAMES, GOOD, HOSTILE, KEY, SLOW, STATE, UNKNOWN_USAGE, answer, echoes, in_turn
from tests.vlm.server import Exchange, serving

IMAGE = np.full((32, 32, 3), 200, np.uint8)
TIMEOUT_S = 0.5
SLACK_S = 1.0
"""Both long enough for a busy machine; without a deadline the slow servers take 3 to 5 s."""


@pytest.fixture(autouse=True)
def _key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


def leaks(text: str) -> bool:
    """Whether a text holds the key, or the beginning of it, in any of the encodings of `echoes`."""
    plain = html.unescape(unquote(unquote(re.sub(r"\\+u00(..)", r"%\1", text)))).lower()
    codes = [base64.b64encode(bytes(i) + KEY.encode()).decode()[4:16].lower() for i in range(3)]
    return any(part in plain for part in (KEY[:7].lower(), KEY[:7].encode().hex(), *codes))


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_server_costs_one_decision_at_most(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture
):
    handler, cause = HOSTILE[name]
    caplog.set_level(logging.DEBUG)
    timeout_s, log = TIMEOUT_S if name in SLOW else 20.0, tmp_path / "log.jsonl"
    with serving(handler) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=timeout_s, retries=1, audit=log), time.monotonic()
        commands = client.plan("Catch it.", STATE, IMAGE)
        seconds = time.monotonic() - start
    assert seconds < timeout_s + SLACK_S
    report = client.report()
    assert report["requests"] == len(seen) == len(log.read_text().splitlines())
    if cause is None:
        np.testing.assert_allclose(commands, np.tile(STATE, (FRAMES, 1)))
        assert (len(seen), report["failed"], report["failed_by"], report["failed_requests_by"]) == (1, 0, {}, {})
    else:
        assert commands is None
        assert (report["decisions"], report["failed"], report["failed_by"]) == (1, 1, {cause: 1})
        assert report["failed_requests_by"] == {cause: len(seen)}
        assert len(seen) == (1 if name in (*SLOW, "limits the rate") else 2)
        assert [json.loads(line)["cause"] for line in log.read_text().splitlines()] == [cause] * len(seen)
    assert not leaks(log.read_text() + json.dumps(report, allow_nan=False) + caplog.text + "".join(capfd.readouterr()))


def test_the_table_knows_every_cause():
    assert {cause for _, cause in HOSTILE.values() if cause} >= {*Cause} - {Cause.CONNECTION, Cause.UNEXPECTED}
    assert len(HOSTILE) >= 40


@pytest.mark.parametrize("name", echoes(KEY))
def test_without_redaction_every_echo_is_stored_or_logged(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    """A control: the test above finds a leak where there is one."""
    caplog.set_level(logging.DEBUG)
    monkeypatch.setattr(Redactor, "__call__", lambda self, text: text)  # of earlier clients, too
    with serving(HOSTILE[name][0]) as (url, _):
        VlmClient("tiny", url, retries=0, audit=tmp_path / "log").plan("", STATE, IMAGE)
    assert leaks((tmp_path / "log").read_text() + caplog.text)


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


@pytest.mark.parametrize(
    ("headers", "wait_s"), [([("Retry-After", "0.3")], 1.0), ([("Retry-After", "1")], 1.0), ([], 1.0)]
)
def test_a_busy_server_is_asked_again_after_the_pause_it_asks_for(headers: list, wait_s: float):
    def handler(exchange: Exchange) -> None:
        if exchange.number == 0:
            exchange.raw(b"{}", 429, headers=headers)
        else:
            exchange.say(answer())

    with serving(handler) as (url, seen):
        client, start = VlmClient("tiny", url, timeout_s=10.0), time.monotonic()
        assert client.plan("", STATE, IMAGE) is not None
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
        client = VlmClient("tiny", url, audit=tmp_path)  # a folder
        assert client.plan("", STATE, IMAGE) is not None
    assert client.account.unlogged == 1


def test_the_log_file_holds_a_bounded_part_of_an_answer(tmp_path: Path):
    with serving(lambda exchange: exchange.say("x" * 900_000)) as (url, _):
        VlmClient("tiny", url, audit=tmp_path / "log", retries=0).plan("", STATE, IMAGE)
    assert 16_000 < (tmp_path / "log").stat().st_size < 18_000


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
    assert not leaks("".join(written) + answer() + "".join(capsys.readouterr()))
