"""Vision-language models: the prompt, every kind of bad answer, the account, and whole episodes."""

import base64
import io
import json
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.protocols import one_hot_phase
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.rollout.inference import Inference, RealTimeAgent
from dynahoi_lerobot.vlm.agent import Answer, ReplyError, VlmAgent, VlmClient, parse_reply
from dynahoi_lerobot.vlm.prompt import HORIZON, SKILLS, messages
from tests.vlm.server import Exchange, Handler, serving

IMAGE = np.full((32, 32, 3), 200, np.uint8)
STATE = np.arange(18) / 10
SEEN = ("", STATE, IMAGE)
KEY = "sk-secret"


@pytest.fixture(autouse=True)
def _key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


def answer(
    motion: list | None = None, durations: tuple[int, ...] = (4, 6), skill: str = "APPROACH"
) -> str:
    """Return a valid answer, or one that differs as told."""
    rows = [STATE.tolist()] * HORIZON if motion is None else motion
    frames = [{"frame_index": i + 1, "hand_params": row} for i, row in enumerate(rows)]
    program = [{"skill": skill, "params": {}, "duration": duration} for duration in durations]
    return json.dumps({"action_sequence": program, "predicted_motion": frames})


# -- reading answers -------------------------------------------------------------------------------


@pytest.mark.parametrize("wrap", ["{}", "```json\n{}\n```", "```\n{}```", "  {}\n"])
def test_a_good_answer_is_read(wrap: str):
    commands, skills = parse_reply(wrap.replace("{}", answer()))
    np.testing.assert_allclose(commands, np.tile(STATE, (HORIZON, 1)))
    assert skills == [("APPROACH", 4), ("APPROACH", 6)]


BAD_ANSWERS = {
    "empty": "",
    "refusal": "I'm sorry, I cannot control a robot.",
    "truncated": answer()[:200],
    "chatter": "Sure! " + answer(),
    "unknown skill": answer(skill="TELEPORT"),
    "too long": answer(durations=(4, 7)),
    "no skills": answer(durations=()),
    "nine frames": answer([STATE.tolist()] * 9),
    "short frame": answer([STATE.tolist()] * 9 + [[0.0] * 17]),
    "infinity": answer().replace("0.1", "1e999", 1),
    "text": answer().replace("0.1", '"0.1"', 1),
}


@pytest.mark.parametrize("name", BAD_ANSWERS)
def test_a_bad_answer_is_refused_with_the_reason(name: str):
    with pytest.raises(ReplyError) as error:
        parse_reply(BAD_ANSWERS[name])
    assert 0 < len(str(error.value)) < 300


@pytest.mark.parametrize("condition", ['"distance < 0.03"', "null", '{"contact": 5}'])
def test_an_answer_may_say_when_a_skill_ends_and_its_rollout_is_played(condition: str):
    conditional = answer().replace('"duration": 4', f'"duration": 4, "terminate_if": {condition}')
    assert "terminate_if" in conditional
    np.testing.assert_array_equal(parse_reply(conditional)[0], parse_reply(answer())[0])
    skill = Answer.model_json_schema()["$defs"]["Step"]
    assert "terminate_if" in skill["properties"]
    assert "terminate_if" not in skill["required"]


def test_the_request_holds_what_the_paper_says():
    system, user = messages("extended", 0.5, "Catch the ball.", STATE, IMAGE)
    assert system["role"] == "system"
    text, picture = user["content"]
    for word in (
        "Catch the ball.",
        "1.7",
        "action_sequence",
        "predicted_motion",
        f"sum to {HORIZON}",
        *SKILLS,
    ):
        assert word in text["text"]
    data = base64.b64decode(picture["image_url"]["url"].removeprefix("data:image/jpeg;base64,"))
    assert np.abs(np.asarray(Image.open(io.BytesIO(data))).astype(int) - 200).max() <= 2
    assert Answer.model_json_schema()["properties"]["predicted_motion"]["minItems"] == HORIZON


# -- the client ------------------------------------------------------------------------------------


def test_worlds_are_decided_side_by_side():
    all_four = threading.Barrier(4)

    def handler(exchange: Exchange) -> None:
        all_four.wait(timeout=10.0)
        time.sleep(0.1)
        exchange.say(answer())

    with serving(handler) as (url, _):
        for commands, took_s in VlmClient("tiny", url).plan([SEEN] * 4):
            assert commands is not None
            assert took_s >= 0.1


def test_a_server_without_structured_output_is_asked_without():
    def handler(exchange: Exchange) -> None:
        if "response_format" in exchange.body:
            exchange.send({"error": {"message": "unsupported"}}, 400)
        else:
            exchange.say(answer())

    with serving(handler) as (url, seen):
        client = VlmClient("tiny", url)
        assert client.plan([SEEN])[0][0] is not None
        assert client.plan([SEEN])[0][0] is not None
    assert ["response_format" in exchange.body for exchange in seen] == [True, False, False]


FAILURES: dict[str, tuple[Handler, str]] = {
    "silence": (lambda e: time.sleep(2.0), "TimeoutError"),
    "a pause beyond the deadline": (
        lambda e: e.send({}, 429, **{"Retry-After": "30"}),
        "TimeoutError",
    ),
    "nothing": (lambda e: None, "APIConnectionError"),
    "a wrong key, which it repeats": (
        lambda e: e.send({"error": {"message": KEY}}, 401),
        "AuthenticationError",
    ),
    "a refusal, which repeats the key": (lambda e: e.say(f"I know {KEY}"), "ReplyError"),
    "HTML": (lambda e: e.send(b"<html>"), "JSONDecodeError"),
    "no choices": (lambda e: e.send({"choices": []}), "IndexError"),
}


@pytest.mark.parametrize("name", FAILURES)
def test_whatever_a_server_does_costs_one_decision(name: str, tmp_path: Path):
    handler, problem = FAILURES[name]
    timeout_s = 0.5 if problem == "TimeoutError" else 20.0
    with serving(handler) as (url, _):
        client = VlmClient("tiny", url, timeout_s=timeout_s, log=tmp_path / "log.jsonl")
        start = time.monotonic()
        assert client.plan([SEEN])[0][0] is None
        assert time.monotonic() - start < timeout_s + 1.0
    report = client.report()
    assert (report["decisions"], report["failed"], set(report["problems"])) == (1, 1, {problem})
    assert KEY not in (tmp_path / "log.jsonl").read_text() + json.dumps(report)


@pytest.mark.parametrize(
    ("key", "url", "problem"),
    [
        ("", None, "OPENAI_API_KEY must be set"),
        ("k", "http://user:secret@h/v1", "user name or password"),
        ("k", "localhost:8000", "must be like"),
    ],
)
def test_a_key_or_address_that_cannot_be_is_refused_unseen(key, url, problem, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(ValueError, match=problem) as refused:
        VlmClient("tiny", url)
    assert "secret" not in str(refused.value)


# -- playing ---------------------------------------------------------------------------------------


class Remembered:
    """A client that counts, and moves up by a centimeter a frame, or fails."""

    def __init__(self, fails: bool = False, took_s: float = 0.0) -> None:
        self.asked = []
        self.fails = fails
        self.took_s = took_s

    def plan(
        self, worlds: list[tuple[str, np.ndarray, np.ndarray]]
    ) -> list[tuple[np.ndarray | None, float]]:
        self.asked += [task for task, _, _ in worlds]
        way = np.arange(1, HORIZON + 1)[:, None] * np.eye(18)[2] * 0.01
        return [(None if self.fails else state + way, self.took_s) for _, state, _ in worlds]


def observe(acting: list[int], idle: tuple[int, ...] = ()) -> Observation:
    n = len(acting)
    images = np.full((n, 8, 8, 3), 9, np.uint8)
    images[list(idle)] = 0
    state = np.ones((n, 18), np.float32)
    tasks = ("a", "b", "c")[:n]
    return Observation({"ego": images}, state, one_hot_phase(np.array(acting, bool)), tasks)


def test_one_request_for_ten_frames_of_each_acting_world():
    agent = VlmAgent(client := Remembered())
    agent.reset(3)
    np.testing.assert_array_equal(agent.act(observe([0, 0, 0])), 1.0)
    assert client.asked == []
    heights = [agent.act(observe([1, 0, 1], idle=(2,)))[:, 2] for _ in range(HORIZON + 1)]
    assert client.asked == ["a", "a"]
    np.testing.assert_allclose([h[0] for h in heights], [*(1 + 0.01 * np.arange(1, 11)), 1.01])
    np.testing.assert_array_equal([h[1:] for h in heights], 1.0)
    failing = VlmAgent(client := Remembered(fails=True))
    failing.reset(1)
    np.testing.assert_array_equal([failing.act(observe([1]))[0, 2] for _ in range(HORIZON)], 1.0)
    assert len(client.asked) == 1, "a failed decision holds still as long"


def evaluated(url: str, *words: str) -> int:
    """Evaluate the model behind an address on episodes of one kind of motion."""
    given = [
        "--policy",
        "vlm",
        "--model",
        "tiny",
        "--base-url",
        url,
        "--motions",
        "constant",
        "--image-size",
        "32",
    ]
    return main(["evaluate", *given, *words])


def test_evaluating_a_model_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture):
    def handler(exchange: Exchange) -> None:
        text = exchange.body["messages"][1]["content"][0]["text"]
        state = json.loads(text[text.index("closed]: ") + 9 :].split("\n")[0])
        exchange.say("no" if exchange.number == 0 else answer([state] * HORIZON))

    with serving(handler) as (url, seen):
        assert evaluated(url, "--episodes", "2", "--out", str(tmp_path)) == 0
    results = read_results(tmp_path)
    assert {results.info.policy, *(row["agent"] for row in results.rows)} == {"vlm:tiny:extended"}
    account = results.info.extra["vlm"]
    n = len(seen)
    assert (account["model"], account["prompt"], account["problems"]) == (
        "tiny",
        "extended",
        {"ReplyError": 1},
    )
    assert (account["answers"], account["decisions"], account["failed"]) == (n, n - 1, 0)
    assert (account["prompt_tokens"], account["completion_tokens"]) == (100 * n, 10 * n)
    lines = list(map(json.loads, (tmp_path / "vlm.jsonl").read_text().splitlines()))
    assert [line["problem"].split(":")[0] for line in lines if "problem" in line] == ["ReplyError"]
    decided = [line["skills"] for line in lines if "problem" not in line]
    assert decided == [[["APPROACH", 4], ["APPROACH", 6]]] * (n - 1)
    assert n > 4
    assert {exchange.key for exchange in seen} == {f"Bearer {KEY}"}
    assert seen[0].body["response_format"]["type"] == "json_schema"
    assert "failed 0" in capsys.readouterr().out


def test_the_account_of_a_run_that_goes_on_is_of_all_its_episodes(tmp_path: Path, capsys):
    with serving(lambda exchange: exchange.say("no")) as (url, seen):
        words = ["--out", str(tmp_path), "--episodes"]
        asked = []
        for episodes in ("1", "2", "2"):
            assert evaluated(url, *words, episodes) == 0
            asked.append((len(seen), read_results(tmp_path).info.extra["vlm"]["answers"]))
    assert [answers for _, answers in asked] == [sent for sent, _ in asked]
    assert 0 < asked[0][0] < asked[1][0] == asked[2][0]
    account = read_results(tmp_path).info.extra["vlm"]
    assert account["problems"] == {"ReplyError": asked[1][0]}
    assert f"answers {asked[1][0]}" in capsys.readouterr().out.splitlines()[-1]


def test_the_papers_prompt_is_sent_and_named_in_every_row(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    words = ["--out", str(tmp_path), "--capture", "attach_lenient"]
    with serving(lambda exchange: exchange.say(answer())) as (url, seen):
        assert evaluated(url, *words, "--prompt", "paper", "--episodes", "1") == 0
        said = set(capsys.readouterr().out.split())
        assert {"vlm:tiny:paper", "test_small,", "attach_lenient,", "standard,"} <= said
        assert evaluated(url, *words, "--prompt", "short") == 2
        assert "unknown prompt 'short'; known: extended, paper" in capsys.readouterr().err
    assert all(
        exchange.body["messages"][1]["content"][0]["text"].startswith("Task. ") for exchange in seen
    )
    (row,) = read_results(tmp_path).rows
    assert (row["agent"], row["capture"]) == ("vlm:tiny:paper", "attach_lenient")


@pytest.mark.parametrize(
    ("settings", "told_m"), [("--control-class=standard", 0.025), ("--capture=contact", 0.1)]
)
def test_the_model_is_told_how_far_the_palm_may_move(settings: str, told_m: float):
    with serving(lambda exchange: exchange.say(answer())) as (url, seen):
        assert evaluated(url, settings, "--episodes", "1") == 0
    told = f"the palm moves at most {told_m} m a frame."
    assert all(told in exchange.body["messages"][1]["content"][0]["text"] for exchange in seen)


def test_a_request_of_120_ms_takes_three_frames_and_ended_worlds_are_not_asked_about():
    seen = replace(observe([1, 1], idle=(1,)), state=np.zeros((2, 18), np.float32))
    agent = RealTimeAgent(VlmAgent(client := Remembered(took_s=0.12)), Inference("async", None))
    agent.reset(2)
    heights = np.array([agent.act(seen)[:, 2] for _ in range(7)])
    np.testing.assert_allclose(heights[:, 0], [0, 0, 0, 0.04, 0.05, 0.06, 0.04], atol=1e-6)
    assert not heights[:, 1].any()
    assert client.asked == ["a"] * 3
