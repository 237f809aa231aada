"""A result folder: what is in it, that it comes back unchanged, and what is said when it is damaged."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.evaluate.intervals import wilson
from dynahoi_lerobot.evaluate.results import (
    ResultsError,
    ResultsRecorder,
    RunInfo,
    read_results,
    summarise,
    write_results,
)
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.synthetic import synthetic_episode

RUN = {
    "policy": "reach",
    "split": "test",
    "capture": "attach",
    "command": "dynahoi evaluate",
    "fingerprint": "f1",
}


def episodes(count: int = 6):
    """Yield episodes of which every third misses by 5 cm, of two kinds and different lengths."""
    for seed in range(count):
        episode = synthetic_episode(seed, frames=40 + seed, image_size=None, miss_m=0.05 * (seed % 3 == 0))
        yield replace(episode, meta=replace(episode.meta, motion=("constant", "lob")[seed % 2]))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_results(tmp_path / "run", episodes(), **RUN, extra={"n_obs_frames": 5})
    return tmp_path / "run"


def test_metrics_json_is_the_documented_table(folder: Path):
    head = json.loads((folder / "metrics.json").read_text())
    assert {key: head[key] for key in RUN} == RUN
    assert head["benchmark"] == BENCHMARK.version
    assert head["n"] == 6
    assert head["extra"] == {"n_obs_frames": 5}
    assert set(head["metrics"]) == set(METRICS.names())
    low, high = wilson(4, 6)
    expected = {"value": pytest.approx(4 / 6), "low": low, "high": high, "unit": "fraction", "n": 6}
    assert head["metrics"]["S_loc"] == expected
    assert set(head["per_kind"]) == {"constant", "lob"}
    assert head["per_kind"]["lob"]["S_loc"]["n"] == 3
    assert head["per_kind"]["lob"]["S_loc"]["value"] == pytest.approx(2 / 3)


def test_conditional_metrics_leave_out_what_does_not_apply(folder: Path):
    metrics = json.loads((folder / "metrics.json").read_text())["metrics"]
    assert metrics["S_gra"]["n"] == 4
    assert metrics["S_hold"] == {"value": None, "low": None, "high": None, "unit": "fraction", "n": 0}


def test_episodes_parquet_has_a_row_an_episode_with_every_metric(folder: Path):
    table = pq.read_table(folder / "episodes.parquet")
    assert table.num_rows == 6
    assert {"seed", "kind", "object", "stage", *METRICS.names()} <= set(table.column_names)
    assert table["S_hold"].null_count == 6
    assert set(table["benchmark"].to_pylist()) == {BENCHMARK.version}
    assert table["stage"].to_pylist() == ["missed", "captured", "captured"] * 2


def test_actions_npz_holds_what_replay_needs(folder: Path):
    with np.load(folder / "actions.npz") as archive:
        offsets, action = archive["offsets"], archive["action"]
        assert archive["seed"].tolist() == list(range(6))
        assert archive["window_frames"].tolist() == [8, 8, 8, 8, 8, 9]
    for index, episode in enumerate(episodes()):
        np.testing.assert_array_equal(action[offsets[index] : offsets[index + 1]], episode.action)


def test_reading_gives_back_what_was_written(folder: Path):
    written = ResultsRecorder()
    written.extend(episodes())
    expected = written.write(folder.parent / "again", RunInfo(**RUN, extra={"n_obs_frames": 5}))
    found = read_results(folder)
    assert found.info == expected.info
    assert found.rows == expected.rows
    assert found.summary() == expected.summary() == summarise(episodes())
    for mine, theirs in zip(found.actions, expected.actions, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_the_same_episodes_give_the_same_bytes(folder: Path):
    write_results(folder.parent / "again", episodes(), **RUN, extra={"n_obs_frames": 5})
    for name in ("metrics.json", "episodes.parquet"):
        assert (folder / name).read_bytes() == (folder.parent / "again" / name).read_bytes()


def test_a_stopped_run_goes_on_where_it_ended(tmp_path: Path):
    every = list(episodes())
    assert len(ResultsRecorder.resume(tmp_path / "part", RunInfo(**RUN))) == 0
    first = ResultsRecorder()
    first.extend(every[:2])
    first.write(tmp_path / "part", RunInfo(**RUN))
    second = ResultsRecorder.resume(tmp_path / "part", RunInfo(**RUN))
    assert second.seeds == {0, 1}
    second.extend(episode for episode in every if episode.meta.seed not in second.seeds)
    second.write(tmp_path / "part", RunInfo(**RUN))
    whole = write_results(tmp_path / "whole", every, **RUN)
    assert read_results(tmp_path / "part").rows == whole.rows
    assert len(read_results(tmp_path / "part").actions) == 6


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"policy": "other"}, "results with policy reach, not other; name another folder"),
        ({"split": "val"}, "split test, not val"),
        ({"capture": "contact"}, "capture rule attach, not contact"),
        ({"fingerprint": "f2"}, "recipe f1, not f2"),
        ({"benchmark": "v0"}, f"benchmark {BENCHMARK.version}, not v0"),
        ({"extra": {"inference": "async 150 ms"}}, "inference none, not async 150 ms"),
        ({"extra": {"weights": {"model.safetensors": "0a" * 32}}}, "weights none, not model.safetensors 0a0a0a0a0a0a;"),
        ({"extra": {"settings": ["n_action_steps=2"]}}, r"settings none, not \['n_action_steps=2'\]"),
    ],
)
def test_a_run_does_not_go_on_with_the_results_of_another(folder: Path, change: dict[str, Any], sentence: str):
    with pytest.raises(ResultsError, match=sentence):
        ResultsRecorder.resume(folder, RunInfo(**{**RUN, **change}))


def test_images_are_not_kept():
    recorder = ResultsRecorder()
    recorder.extend([synthetic_episode(image_size=16)])
    assert all(not isinstance(value, np.ndarray) for value in recorder._rows[0].values())


def test_a_failed_write_leaves_the_earlier_results_alone(folder: Path):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(TypeError):
        write_results(folder, episodes(3), **RUN, extra={"not": object()})
    with pytest.raises(ValueError, match="Out of range float"):
        write_results(folder, episodes(3), **RUN, extra={"lr": float("nan")})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_drafts_are_removed_when_writing_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(np, "savez", lambda *_, **__: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_results(tmp_path / "run", episodes(), **RUN)
    assert list((tmp_path / "run").iterdir()) == []


def test_no_episodes_are_no_results(tmp_path: Path):
    with pytest.raises(ValueError, match="at least one"):
        write_results(tmp_path, [], **RUN)


def test_capture_rules_are_not_mixed(tmp_path: Path):
    with pytest.raises(ValueError, match="seed 0 was played under the capture rule 'attach'"):
        write_results(tmp_path, episodes(), **{**RUN, "capture": "contact"})


def test_a_missing_folder_is_named(tmp_path: Path):
    with pytest.raises(ResultsError, match=r"no result folder .*nowhere; run `dynahoi evaluate`"):
        read_results(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["metrics.json", "episodes.parquet", "actions.npz"])
def test_a_missing_or_damaged_file_is_named(folder: Path, name: str):
    whole = (folder / name).read_bytes()
    (folder / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ResultsError, match=rf"{name} is damaged") as damaged:
        read_results(folder)
    (folder / name).unlink()
    with pytest.raises(ResultsError, match=rf"{name} is missing") as missing:
        read_results(folder)
    assert "\n" not in str(damaged.value) + str(missing.value)


def test_a_missing_key_is_named(folder: Path):
    head = json.loads((folder / "metrics.json").read_text())
    del head["command"]
    (folder / "metrics.json").write_text(json.dumps(head))
    with pytest.raises(ResultsError, match="it lacks command"):
        read_results(folder)


def test_files_of_two_runs_are_told_apart(folder: Path):
    write_results(folder.parent / "short", episodes(2), **RUN)
    (folder.parent / "short" / "actions.npz").replace(folder / "actions.npz")
    with pytest.raises(ResultsError, match=r"actions.npz is damaged"):
        read_results(folder)


def test_importing_pulls_in_nothing_heavy():
    code = (
        "import sys, dynahoi_lerobot.metrics, dynahoi_lerobot.evaluate.results, dynahoi_lerobot.evaluate.gif, "
        "dynahoi_lerobot.report as r; print({'torch', 'lerobot', 'pandas', 'pyarrow', 'matplotlib', 'PIL', 'jinja2'}"
        " & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "set()"
