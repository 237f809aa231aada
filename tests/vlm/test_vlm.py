"""Vision-language models: the prompt, every kind of bad answer, the account, and whole episodes."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.rules import one_hot_phase
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.rollout.inference import Inference, RealTimeAgent
from dynahoi_lerobot.vlm import agent as vlm_agent
from dynahoi_lerobot.vlm.agent import VlmAgent
from dynahoi_lerobot.vlm.client import VlmClient
from dynahoi_lerobot.vlm.prompt import HORIZON, SKILLS, Prompt
from dynahoi_lerobot.vlm.reply import Answer, ReplyError, parse_reply
from tests.vlm.hostile import STATE, answer
from tests.vlm.server import Exchange, serving

IMAGE = np.full((32, 32, 3), 200, np.uint8)


# -- reading answers -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrap", ["{}", "```json\n{}\n```", "```\n{}```", "  {}\n"])
def test_a_good_answer_is_read(wrap: str):
    commands, skills = parse_reply(wrap.replace("{}", answer()))
    np.testing.assert_allclose(commands, np.tile(STATE, (HORIZON, 1)))
    assert skills == [("APPROACH", 4), ("APPROACH", 6)]


WRONG_LENGTH = [STATE.tolist()] * 9
SHORT_FRAME = [STATE.tolist()] * 9 + [[0.0] * 17]
BAD_ANSWERS = {
    "empty": "",
    "refusal": "I'm sorry, I cannot control a robot.",
    "truncated": answer()[:200],
    "chatter": "Sure! " + answer(),
    "array": "[1, 2]",
    "nothing": "{}",
    "unknown skill": answer(skill="TELEPORT"),
    "too long": answer(durations=(4, 7)),
    "zero": answer(durations=(10, 0)),
    "fraction": answer().replace('"duration": 4', '"duration": 4.5'),
    "no skills": answer(durations=()),
    "nine frames": answer(WRONG_LENGTH),
    "short frame": answer(SHORT_FRAME),
    "NaN": answer().replace("0.1", "NaN", 1),
    "infinity": answer().replace("0.1", "1e999", 1),
    "text": answer().replace("0.1", '"0.1"', 1),
    "flag": answer().replace("0.1", "true", 1),
    "deep": "[" * 30_000,
    "bomb": '{"a": ' + "[" * 30_000 + "]" * 30_000 + "}",
    "401 digits": answer().replace("0.1", "1" + "0" * 400, 1),
    "lone surrogates": "\ud800" * 10,
    "frames of numbers": json.dumps({**json.loads(answer()), "predicted_motion": [1] * 10}),
}


@pytest.mark.parametrize("name", BAD_ANSWERS)
def test_a_bad_answer_is_refused_with_the_reason(name: str):
    with pytest.raises(ReplyError) as error:
        parse_reply(BAD_ANSWERS[name])
    assert 0 < len(str(error.value)) < 300


PAPER_PROMPT = """Task. Catch the ball.
Input. RGB image + current hand state s_t ∈ R^18: [x, y, z, 15 joint angles (rad)] = STATE.
Skill Set. {WAIT, APPROACH, INTERCEPT, GRASP, LIFT, ADJUST}.
Output. Return (i) a parameterized skill program whose durations sum to 10, and (ii) an explicit low-level rollout of \
the next 10 frames, each with 18 values in the same order.
Return only the following JSON:
{
  "action_sequence": [
    {
      "skill": "APPROACH",
      "params": {"target": "object",......},
      "duration": 4,
      "terminate_if": ...,
    },
    {
      "skill": "GRASP",
      "params": {...},
      "duration": 6
    }
  ],
  "predicted_motion": [
    {"frame_index": 1, "hand_params": [18 values]},
    ...,
    {"frame_index": 10, "hand_params": [18 values]}
  ]
}"""


def test_the_papers_prompt_is_literal():
    system, user = Prompt("paper").messages("Catch the ball.", STATE, IMAGE)
    assert system["content"] == "You are a Vision-Language-Action agent for dynamic hand-object interaction."
    text = user["content"][0]["text"]
    assert text == PAPER_PROMPT.replace("STATE", str(np.round(STATE.astype(float), 4).tolist()))


@pytest.mark.parametrize("condition", ['"distance < 0.03"', "true", "null", '{"contact": 5}', "0.5"])
def test_an_answer_may_say_when_a_skill_ends_and_its_rollout_is_played(condition: str):
    conditional = answer().replace('"duration": 4', f'"duration": 4, "terminate_if": {condition}')
    assert "terminate_if" in conditional
    np.testing.assert_array_equal(parse_reply(conditional)[0], parse_reply(answer())[0])
    skill = Answer.model_json_schema()["$defs"]["Step"]
    assert "terminate_if" in skill["properties"]
    assert "terminate_if" not in skill["required"]


def test_the_request_holds_what_the_paper_says():
    system, user = Prompt().messages("Catch the ball.", STATE, IMAGE)
    assert system["role"] == "system"
    text, picture = user["content"]
    for word in ("Catch the ball.", "1.7", "action_sequence", "predicted_motion", f"sum to {HORIZON}", *SKILLS):
        assert word in text["text"]
    data = base64.b64decode(picture["image_url"]["url"].removeprefix("data:image/jpeg;base64,"))
    assert np.abs(np.asarray(Image.open(io.BytesIO(data))).astype(int) - 200).max() <= 2
    assert Answer.model_json_schema()["properties"]["predicted_motion"]["minItems"] == HORIZON


# -- the client ----------------------------------------------------------------------------------------------------


def test_a_plan_and_its_account(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OPENAI_API_KEY", "sk-secret")
    log = tmp_path / "vlm.jsonl"
    with serving(lambda exchange: exchange.say(answer())) as (url, seen):
        client = VlmClient("tiny", url, prices=(1.0, 2.0), log=log)
        np.testing.assert_allclose(client.plan("Catch it.", STATE, IMAGE), np.tile(STATE, (HORIZON, 1)))
    report = client.report()
    assert (report["model"], report["decisions"], report["requests"], report["failed"]) == ("tiny", 1, 1, 0)
    assert (report["prompt_tokens"], report["completion_tokens"]) == (100, 10)
    assert report["cost"] == pytest.approx(120e-6)
    assert seen[0].key == "Bearer sk-secret"
    assert seen[0].body["response_format"]["type"] == "json_schema"
    line = json.loads(log.read_text())
    assert line["skills"] == [["APPROACH", 4], ["APPROACH", 6]]
    assert (line["task"], line["cause"], line["usage"]) == ("Catch it.", None, [100, 10])


def test_a_server_without_structured_output_is_asked_without(monkeypatch: pytest.MonkeyPatch):
    def handler(exchange: Exchange) -> None:
        if "response_format" in exchange.body:
            exchange.send({"error": {"message": "unsupported"}}, 400)
        else:
            exchange.say(answer())

    with serving(handler) as (url, seen):
        client = VlmClient("tiny", url)
        assert client.plan("", STATE, IMAGE) is not None
        assert client.plan("", STATE, IMAGE) is not None
    assert ["response_format" in exchange.body for exchange in seen] == [True, False, False]


def test_a_broken_answer_is_asked_for_again():
    def handler(exchange: Exchange) -> None:
        exchange.say(answer() if exchange.number == 1 else "no")

    with serving(handler) as (url, _):
        client = VlmClient("tiny", url)
        assert client.plan("", STATE, IMAGE) is not None
    assert (client.account.requests, client.account.failed_requests_by, client.account.failed) == (
        2,
        {"unplayable": 1},
        0,
    )


# -- playing -------------------------------------------------------------------------------------------------------


class Remembered:
    """A client that counts, and moves up by a centimetre a frame, or fails."""

    def __init__(self, fails: bool = False) -> None:
        self.asked, self.fails = [], fails

    def plan(self, task: str, state: np.ndarray, image: np.ndarray) -> np.ndarray | None:
        self.asked.append(task)
        return None if self.fails else state + np.arange(1, HORIZON + 1)[:, None] * np.eye(18)[2] * 0.01


def observe(acting: list[int], idle: tuple[int, ...] = ()) -> Observation:
    n = len(acting)
    images = np.full((n, 8, 8, 3), 9, np.uint8)
    images[list(idle)] = 0
    state = np.ones((n, 18), np.float32)
    tasks = ("a", "b", "c")[:n]
    return Observation({"ego": images}, state, one_hot_phase(np.array(acting, bool)), tasks)


def test_one_request_for_ten_frames_of_each_acting_world():
    client = Remembered()
    agent = VlmAgent(client)
    agent.reset(3)
    np.testing.assert_array_equal(agent.act(observe([0, 0, 0])), 1.0)
    assert client.asked == []
    heights = [agent.act(observe([1, 0, 1], idle=(2,)))[:, 2] for _ in range(HORIZON + 1)]
    assert client.asked == ["a", "a"]
    np.testing.assert_allclose([h[0] for h in heights], [*(1 + 0.01 * np.arange(1, 11)), 1.01])
    np.testing.assert_array_equal([h[1:] for h in heights], 1.0)


def test_a_failed_decision_holds_still_for_ten_frames():
    client = Remembered(fails=True)
    agent = VlmAgent(client)
    agent.reset(1)
    for _ in range(HORIZON):
        np.testing.assert_array_equal(agent.act(observe([1])), 1.0)
    assert len(client.asked) == 1


def test_evaluating_a_model_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture):
    def handler(exchange: Exchange) -> None:
        text = exchange.body["messages"][1]["content"][0]["text"]
        state = json.loads(text[text.index("closed]: ") + 9 :].split("\n")[0])
        exchange.say("no" if exchange.number == 0 else answer([state] * HORIZON))

    out = tmp_path / "results"
    with serving(handler) as (url, _):
        words = ["--policy", "vlm", "--model", "tiny", "--base-url", url, "--motions", "constant"]
        assert main(["evaluate", *words, "--episodes", "2", "--image-size", "32", "--out", str(out)]) == 0
    head = json.loads((out / "metrics.json").read_text())
    assert head["policy"] == "vlm:tiny:extended"
    assert {row["agent"] for row in read_results(out).rows} == {"vlm:tiny:extended"}
    assert head["extra"]["vlm"]["prompt"] == "extended"
    account = head["extra"]["vlm"]
    assert account["failed_requests_by"] == {"unplayable": 1}
    assert account["failed"] == 0
    assert account["requests"] == len((out / "vlm.jsonl").read_text().splitlines()) > 4
    assert "failed 0" in capsys.readouterr().out


def test_the_papers_prompt_is_sent_and_named_in_every_row(tmp_path: Path, capsys: pytest.CaptureFixture):
    def handler(exchange: Exchange) -> None:
        assert exchange.body["messages"][1]["content"][0]["text"].startswith("Task. ")
        exchange.say(answer())

    out = tmp_path / "results"
    with serving(handler) as (url, _):
        words = ["evaluate", "--policy", "vlm", "--model", "tiny", "--base-url", url, "--motions", "constant"]
        words += ["--image-size", "32", "--out", str(out), "--capture", "attach_lenient"]
        assert main([*words, "--prompt", "paper", "--episodes", "1"]) == 0
        said = set(capsys.readouterr().out.split())
        assert {"vlm:tiny:paper", "test_small,", "attach_lenient,", "standard,"} <= said
        assert main([*words, "--prompt", "extended", "--episodes", "2"]) == 2
        assert "another run (other policy)" in capsys.readouterr().err
        assert main([*words, "--prompt", "short"]) == 2
        assert "unknown prompt 'short'; known: extended, paper" in capsys.readouterr().err
    (row,) = read_results(out).rows
    assert (row["agent"], row["capture"]) == ("vlm:tiny:paper", "attach_lenient")
    account = read_results(out).info.extra["vlm"]
    assert (account["prompt"], account["failed"]) == ("paper", 0)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (["--control-class", "standard"], "the palm moves at most 0.025 m a frame."),
        (["--control-class", "unlimited"], "the palm moves at most 0.1 m a frame."),
        (["--control-class", "standard", "--capture", "contact"], "the palm moves at most 0.1 m a frame."),
    ],
)
def test_the_model_is_told_how_far_the_palm_may_move(settings: list[str], told: str):
    with serving(lambda exchange: exchange.say(answer())) as (url, seen):
        words = ["--policy", "vlm", "--model", "tiny", "--base-url", url, "--motions", "constant", *settings]
        assert main(["evaluate", *words, "--episodes", "1", "--image-size", "32"]) == 0
    assert all(told in exchange.body["messages"][1]["content"][0]["text"] for exchange in seen)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ([], "--policy vlm needs --model NAME"),
        (["--model", "m", "--request-timeout", "nan"], "got nan"),
        (["--model", "m", "--request-timeout", "0"], "got 0"),
        (["--model", "m", "--prices", "0", "-1"], "-1"),
        (["--model", "m", "--prices", "inf", "0"], "got inf"),
        (["--model", "m", "--protocol", "observe_then_blind"], "observe_then_blind"),
    ],
)
def test_what_a_model_cannot_play_with_is_refused(words: list[str], problem: str, capsys: pytest.CaptureFixture):
    assert main(["evaluate", "--policy", "vlm", *words]) == 2
    assert problem in capsys.readouterr().err


class SlowClient:
    """Needs 120 ms, of a clock that nothing else moves, to say: go where the number of the request is."""

    def __init__(self) -> None:
        self.requests, self.seconds = 0, 0.0

    def monotonic(self) -> float:
        return self.seconds

    def plan(self, task: str, state: np.ndarray, image: np.ndarray) -> np.ndarray:
        self.seconds += 0.12
        self.requests += 1
        return np.full((HORIZON, 18), float(self.requests))


def test_a_request_of_120_ms_takes_three_frames_and_ended_worlds_are_not_asked_about(monkeypatch: pytest.MonkeyPatch):
    seen, client = observe([1, 1], idle=(1,)), SlowClient()
    seen = replace(seen, state=np.zeros((2, 18), np.float32))
    monkeypatch.setattr(vlm_agent, "time", client)
    agent = RealTimeAgent(VlmAgent(client), Inference("async", None))
    agent.reset(2)
    commands = np.array([agent.act(seen)[:, 0] for _ in range(7)])
    assert commands[:, 0].tolist() == [0, 0, 0, 1, 1, 1, 2]
    assert commands[:, 1].tolist() == [0] * 7
    assert client.requests == 3
