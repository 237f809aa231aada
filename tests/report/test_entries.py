"""Labels are short, telling and unique, whatever policies are called."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.compatibility import MixedError
from dynahoi_lerobot.evaluate.results import Results, ResultsError, RunInfo
from dynahoi_lerobot.report.entries import LABEL_LENGTH, distinct_episodes, read_entries, short_name, unique_labels
from dynahoi_lerobot.report.tables import main_metrics
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.report.example_runs import example_run


def named(policy: str, folder: str = "run") -> Results:
    return Results(Path(folder), RunInfo(policy, "test", "attach", "cmd", "f"), (), ())


@pytest.mark.parametrize(
    ("policy", "label"),
    [
        ("expert", "expert"),
        ("outputs/train/tracker/checkpoints/last/pretrained_model", "tracker"),
        ("outputs/study/act/training/checkpoints/last/pretrained_model", "act"),
        (r"outputs\tracker\checkpoints\030000\pretrained_model", "tracker"),
        ("someone/tracker_dynahoi", "tracker_dynahoi"),
        ("last", "last"),
        ("", "?"),
        ("two\nlines\x00", "two?lines?"),
    ],
)
def test_the_telling_part_of_a_name(policy: str, label: str):
    assert short_name(policy) == label


def test_long_names_keep_both_ends():
    label = short_name("a" + "x" * 99 + "z")
    assert len(label) <= LABEL_LENGTH
    assert (label[0], label[-1]) == ("a", "z")


def test_equal_names_are_told_apart_by_folder_and_then_by_number():
    assert unique_labels([named("tracker", "s1"), named("tracker", "s5"), named("hold")]) == [
        "tracker (s1)",
        "tracker (s5)",
        "hold",
    ]
    assert unique_labels([named("a", "x/run"), named("a", "y/run")]) == ["a (run) #1", "a (run) #2"]


def test_a_policy_whose_inference_takes_time_is_labelled_as_such():
    late = replace(named("tracker"), info=replace(named("tracker").info, extra={"inference": "async 150 ms"}))
    assert unique_labels([late, named("tracker")]) == ["tracker, async 150 ms", "tracker"]


def test_entries_come_best_first_and_once(tmp_path: Path):
    example_run(tmp_path / "weak", "weak", 0.2, 6)
    example_run(tmp_path / "strong", "strong", 1.0, 8)
    entries = read_entries([tmp_path / "weak", tmp_path / "strong", tmp_path / "weak" / ".." / "weak"])
    assert [entry.label for entry in entries] == ["strong", "weak"]
    assert len({entry.colour for entry in entries}) == 2
    assert len(distinct_episodes(entries)) == 8


def test_a_stratum_is_computed_once(tmp_path: Path):
    example_run(tmp_path / "run", "run", 0.5, 4)
    (entry,) = read_entries([tmp_path / "run"])
    assert entry.by("kind") is entry.by("kind")
    other = replace(entry, label="other")
    assert other.by("kind") == entry.by("kind")


def test_a_missing_folder_is_named(tmp_path: Path):
    with pytest.raises(ResultsError, match="nowhere"):
        read_entries([tmp_path / "nowhere"])


def test_versions_of_the_benchmark_are_not_mixed_unless_asked(tmp_path: Path, capsys: pytest.CaptureFixture):
    old, new = tmp_path / "old", tmp_path / "new"
    example_run(old, "old", 0.5, 4, benchmark="v0")
    example_run(new, "new", 0.5, 4)
    sentence = f"{old} has benchmark 'v0', {new} has benchmark '{BENCHMARK.version}'; evaluate both under one version"
    with pytest.raises(MixedError, match=re.escape(sentence)):
        read_entries([old, new])
    assert main(["report", str(old), str(new), "--out", str(tmp_path / "page.html")]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "page.html").exists()
    words = ["report", str(old), str(new), "--out", str(tmp_path / "page.html"), "--allow-version-mismatch"]
    assert main(words) == 0
    assert all(version in (tmp_path / "page.html").read_text() for version in ("v0", BENCHMARK.version))
    assert not any(
        cell.mark for row in main_metrics(read_entries([old, new], allow_version_mismatch=True)).rows for cell in row
    )
