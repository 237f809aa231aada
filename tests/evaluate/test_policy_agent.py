"""A checkpoint as an agent: its config can be changed for one evaluation, never silently."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent, PolicyError
from dynahoi_lerobot.evaluate.results import read_results

CHECKPOINT = str(Path(__file__).parents[2] / "checkpoints" / "obact_standard")


def test_settings_change_the_config_and_nothing_else() -> None:
    plain = PolicyAgent(CHECKPOINT)._policy.config
    changed = PolicyAgent(CHECKPOINT, settings=["n_action_steps=2", "delay_frames=3"])._policy.config
    assert (plain.n_action_steps, plain.delay_frames) == (1, 0)
    assert (changed.n_action_steps, changed.delay_frames) == (2, 3)
    assert {**changed.__dict__, "n_action_steps": 1, "delay_frames": 0} == plain.__dict__


def test_results_say_which_weights_they_are_of(tmp_path: Path) -> None:
    copied = Path(shutil.copytree(CHECKPOINT, tmp_path / "policy"))
    words = ["evaluate", "--policy", str(copied), "--split", "val", "--episodes", "1", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in copied.glob("*.safetensors")}
    assert read_results(tmp_path / "out").info.extra["weights"] == digests


@pytest.mark.parametrize("mode", ["async", "rtc"])
def test_a_measured_inference_is_of_one_world_and_may_outlast_the_chunk_before(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, worlds = PolicyAgent.plan, []

    def slow(agent: PolicyAgent, observation: Observation, chosen: np.ndarray, **told: Any) -> tuple:
        worlds.append(len(observation.state))
        return plan(agent, observation, chosen, **told)[0], np.full(1, 0.55)  # its chunks are of 8 frames, 0.4 s

    monkeypatch.setattr(PolicyAgent, "plan", slow)
    words = ["evaluate", "--policy", CHECKPOINT, "--split", "val", "--episodes", "2", "--out", str(tmp_path)]
    assert main([*words, "--control-class", "unlimited", "--inference", mode, "--inference-ms", "measured"]) == 0
    assert set(worlds) == {1}
    assert read_results(tmp_path).info.extra["inference_frames"] == 11.0


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("delay=3", "cannot set 'delay=3': must be KEY=VALUE, KEY one of .*delay_frames"),
        ("delay_frames", "cannot set 'delay_frames': must be KEY=VALUE"),
        ("n_action_steps=9", "cannot set n_action_steps=9: n_action_steps is 9, but must be 1 to 8"),
        ("delay_frames=few", "cannot set delay_frames=few: .*'few'"),
    ],
)
def test_what_cannot_be_set_is_said(setting: str, sentence: str) -> None:
    with pytest.raises(PolicyError, match=sentence):
        PolicyAgent(CHECKPOINT, settings=[setting])
