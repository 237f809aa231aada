"""Evaluations are paired under equal conditions, or across the one that is compared."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.compatibility import MixedError
from dynahoi_lerobot.evaluate.compare import compare_results
from dynahoi_lerobot.evaluate.results import Results, write_results
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.report.example_runs import play

PLAIN = {"protocol": "observe_before_act", "control_class": "standard"}


def results(folder: Path, skill: float, inference: str = "", capture: str = "attach", **meta: str) -> Results:
    episodes = play(12, skill, capture, benchmark=BENCHMARK.version, **PLAIN | meta)
    told = {"split": "test_small", "capture": capture, "command": "dynahoi evaluate", "fingerprint": "f00d"}
    return write_results(folder, episodes, policy=folder.name, extra={"inference": inference}, **told)


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        ({"protocol": "direct_act"}, "has protocol 'direct_act'; add --across protocol to compare exactly that"),
        ({"control_class": "late"}, "has control_class 'late'; add --across control_class to compare exactly that"),
        ({"inference": "async 150 ms"}, "has inference 'async 150 ms'; add --across inference to compare exactly that"),
        ({"capture": "contact"}, "has capture 'contact'; evaluate both under one"),
    ],
)
def test_other_conditions_are_refused_in_a_sentence(tmp_path: Path, other: dict, sentence: str):
    a, b = results(tmp_path / "a", 0.9), results(tmp_path / "b", 0.3, **other)
    with pytest.raises(MixedError, match=sentence):
        compare_results(a, b, "S_loc")
    (axis,) = other
    if axis != "capture":
        assert compare_results(a, b, "S_loc", across=[axis]).n == 12
        with pytest.raises(MixedError):
            compare_results(a, b, "S_loc", across=[name for name in ("protocol", "inference") if name != axis])


@pytest.mark.slow
def test_the_report_pairs_across_what_it_is_asked_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    results(tmp_path / "a", 0.9)
    results(tmp_path / "b", 0.3, protocol="observe_then_blind")
    words = ["report", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "report.html")]
    assert main(words) == 0
    assert "not paired: evaluations of different protocol; add --across protocol" in capsys.readouterr().out
    assert "Paired comparison" not in (tmp_path / "report.html").read_text()
    assert main([*words, "--across", "protocol"]) == 0
    assert "not paired" not in capsys.readouterr().out
    assert "Paired comparison" in (tmp_path / "report.html").read_text()
