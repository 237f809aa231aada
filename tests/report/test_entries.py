"""Labels are short, telling and unique, whatever policies are called."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.compatibility import MixedError
from dynahoi_lerobot.evaluate.results import Results, RunInfo
from dynahoi_lerobot.report.entries import LABEL_LENGTH, distinct_episodes, read_entries, short_name, unique_labels
from dynahoi_lerobot.report.figures import FIGURES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.report.example_runs import example_run


def named(policy: str, folder: str = "run", **extra: object) -> Results:
    return Results(Path(folder), RunInfo(policy, "test", "attach", "cmd", "f", extra), (), ())


@pytest.mark.parametrize(
    ("policy", "label"),
    [
        ("expert", "expert"),
        ("outputs/train/obact/checkpoints/last/pretrained_model", "obact"),
        ("outputs/study/act/training/checkpoints/last/pretrained_model", "act"),
        (r"outputs\obact\checkpoints\030000\pretrained_model", "obact"),
        ("someone/obact_dynahoi", "obact_dynahoi"),
        ("last", "last"),
        ("", "?"),
        ("two\nlines\x1b", r"two\nlines\x1b"),
    ],
)
def test_the_telling_part_of_a_name(policy: str, label: str):
    assert short_name(policy) == label


def test_long_names_keep_both_ends():
    label = short_name("a" + "x" * 99 + "z")
    assert len(label) <= LABEL_LENGTH
    assert (label[0], label[-1]) == ("a", "z")


def test_equal_names_are_told_apart_by_conditions_then_folder_then_number():
    late = named("obact", inference="async 150 ms")
    noisy = named("obact", recipe={"render_noise": 2})
    assert unique_labels([late, noisy, named("obact")]) == ["obact, async 150 ms", "obact, noise 2", "obact"]
    assert unique_labels([named("a", "s1"), named("a", "s5"), named("b")]) == ["a (s1)", "a (s5)", "b"]
    assert unique_labels([named("a", "x/run"), named("a", "y/run")]) == ["a (run) #1", "a (run) #2"]


def test_entries_come_best_first_and_once(tmp_path: Path):
    example_run(tmp_path / "weak", "weak", 0.2, 6)
    example_run(tmp_path / "strong", "strong", 1.0, 8)
    entries = read_entries([tmp_path / "weak", tmp_path / "strong", tmp_path / "weak" / ".." / "weak"])
    assert [entry.label for entry in entries] == ["strong", "weak"]
    assert len({entry.colour for entry in entries}) == 2
    assert len(distinct_episodes(entries)) == 8


def test_versions_of_the_benchmark_are_not_mixed_unless_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("dynahoi_lerobot.report.figures.FIGURES", FIGURES[:1])
    old, new, page = tmp_path / "old", tmp_path / "new", tmp_path / "page.html"
    example_run(old, "old", 0.5, 4, benchmark="v0")
    example_run(new, "new", 0.5, 4)
    sentence = f"{old} has benchmark 'v0', {new} has benchmark '{BENCHMARK.version}'"
    with pytest.raises(MixedError, match=re.escape(sentence)):
        read_entries([old, new])
    words = ["report", str(old), str(new), "--out", str(page)]
    assert main(words) == 2
    assert sentence in capsys.readouterr().err
    assert not page.exists()
    assert main([*words, "--allow-version-mismatch"]) == 0
    assert all(version in page.read_text() for version in ("v0", BENCHMARK.version))


def test_the_report_pairs_across_what_it_is_asked_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("dynahoi_lerobot.report.figures.FIGURES", FIGURES[:1])
    example_run(tmp_path / "a", "a", 0.9, 8, recipe={"render_noise": 0})
    example_run(tmp_path / "b", "a", 0.3, 8, recipe={"render_noise": 2})
    words = ["report", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "report.html")]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "--across render_noise" in said
    assert "minus" not in said
    assert "Paired comparison" not in (tmp_path / "report.html").read_text()
    assert main([*words, "--across", "render_noise"]) == 0
    said = capsys.readouterr().out
    assert "--across" not in said
    assert "a minus a, noise 2, 8 episodes: S_loc +" in said
    assert "cm apart" in said
    assert "Paired comparison" in (tmp_path / "report.html").read_text()
