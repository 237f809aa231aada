"""A result folder: what is in it, that it comes back unchanged, and that an interrupted run loses
nothing.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.evaluate.results import Results, command_line, read_results
from dynahoi_lerobot.evaluate.summary import wilson
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from tests.evaluate.test_replay_results import set_head
from tests.synthetic import run_info, synthetic_episode, write_results

INFO = run_info(extra={"n_obs_frames": 5})


def episodes(count: int = 6):
    """Yield episodes of which every third misses by 5 cm, of two kinds and different lengths."""
    for seed in range(count):
        episode = synthetic_episode(
            seed, frames=40 + seed, image_size=None, miss_m=0.05 * (seed % 3 == 0)
        )
        yield replace(episode, meta=replace(episode.meta, motion=("constant", "lob")[seed % 2]))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_results(tmp_path / "run", episodes(), INFO)
    return tmp_path / "run"


def test_the_files_are_as_documented(folder: Path):
    head = json.loads((folder / "metrics.json").read_text())
    told = {**vars(run_info()), "n": 6, "extra": {"n_obs_frames": 5}}
    assert {name: head[name] for name in told} == json.loads(json.dumps(told))
    assert (head["split"], head["capture"]) == ("test", "attach")
    assert set(head["metrics"]) == set(METRICS.names())
    low, high = wilson(4, 6)
    expected = {"value": pytest.approx(4 / 6), "low": low, "high": high, "unit": "fraction", "n": 6}
    assert head["metrics"]["S_loc"] == expected
    assert head["metrics"]["S_gra"]["n"] == 4
    assert head["metrics"]["S_hold"] == {
        "value": None,
        "low": None,
        "high": None,
        "unit": "fraction",
        "n": 0,
    }
    assert {kind: metrics["S_loc"]["n"] for kind, metrics in head["per_kind"].items()} == {
        "constant": 3,
        "lob": 3,
    }
    found = read_results(folder)
    assert (found.info, found.head) == (INFO, head)
    table = pq.read_table(folder / "episodes.parquet")
    assert {"seed", "kind", "object", "stage", *METRICS.names()} <= set(table.column_names)
    assert table["stage"].to_pylist() == ["missed", "captured", "captured"] * 2
    with np.load(folder / "actions.npz") as archive:
        assert archive["seed"].tolist() == list(range(6))
        logs = np.split(archive["action"], archive["offsets"][1:-1])
    for log, episode in zip(logs, episodes(), strict=True):
        np.testing.assert_array_equal(log, episode.action)


def save(folder: Path, count: int) -> None:
    write_results(folder, episodes(count), run_info())


@pytest.mark.parametrize("renamed", [0, 1, 2, 3])
@pytest.mark.parametrize("before", [0, 2])
def test_an_interrupted_run_resumes_whichever_files_it_had_renamed(
    tmp_path: Path, before: int, renamed: int
):
    part, drafts = tmp_path / "part", tmp_path / "drafts"
    part.mkdir()
    if before:
        save(part, before)
    save(drafts, 4)
    for name in ("episodes.parquet", "actions.npz", "metrics.json")[:renamed]:
        shutil.copy(drafts / name, part / name)
    results = Results.resumed(part, INFO)
    assert results.seeds == set(range(4 if renamed >= 2 else before))
    results.plus(
        [episode for episode in episodes() if episode.meta.seed not in results.seeds]
    ).write()
    whole = write_results(tmp_path / "whole", episodes(), INFO)
    assert read_results(part).rows == whole.rows
    assert all(map(np.array_equal, read_results(part).actions, whole.actions))


def test_files_of_two_runs_are_told_apart(folder: Path):
    save(folder.parent / "short", 2)
    shutil.copy(folder.parent / "short" / "actions.npz", folder / "actions.npz")
    with pytest.raises(ReadError, match=r"metrics.json 6, episodes.parquet 6, actions.npz 2"):
        read_results(folder)


def test_a_command_line_is_kept_printable(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["/bin/dynahoi", "evaluate", "a\x1b[2J\nb"])
    assert command_line() == r"dynahoi evaluate a\x1b[2J\nb"


# -- damage ----------------------------------------------------------------------------------------


def set_column(name: str, values: list) -> Callable[[Path], None]:
    """Return a function that replaces or adds a column of ``episodes.parquet``."""

    def change(folder: Path) -> None:
        table = pq.read_table(folder / "episodes.parquet")
        columns = {key: table[key] for key in table.column_names} | {name: pa.array(values)}
        pq.write_table(pa.table(columns), folder / "episodes.parquet")

    return change


def set_action(name: str, edit: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """Return a function that replaces an array of ``actions.npz``."""

    def change(folder: Path) -> None:
        with np.load(folder / "actions.npz") as archive:
            arrays = dict(archive)
        np.savez(folder / "actions.npz", **arrays | {name: edit(arrays[name])})

    return change


def repeat(folder: Path) -> None:
    path = folder / "episodes.parquet"
    pq.write_table(pa.concat_tables([pq.read_table(path)] * 2000), path)


DAMAGE: list[tuple[Callable[[Path], None], str]] = [
    (set_head(n=0), "disagree"),
    (repeat, "12000 episodes"),
    (set_head(n="4"), "n must be of type int, got '4'"),
    (set_head(benchmark="v0"), f"episodes of benchmark 'v0' and '{BENCHMARK_ID}'"),
    (set_column("surplus", [0] * 6), "its column surplus"),
    (set_column("S_loc", ["a"] * 6), "its column S_loc"),
    (
        set_column("control_class", ["late"] * 5 + ["standard"]),
        "control_class 'late' and 'standard'",
    ),
    (set_action("seed", lambda old: old + 1), "its seeds are not those of"),
    (set_column("window_frames", [40] * 6), "seed 0 has 40 commands, and window_frames is 40"),
    (
        set_column("first_localized", [None, 40, 40, 43, None, 40]),
        "seed 3 has 43 commands, and first_localized is 43",
    ),
    (
        set_column("length_frames", [2**62] * 6),
        "it says length_frames of an episode is 4611686018427387904",
    ),
    (set_column("E_loc", [1e308] * 6), "it says E_loc of an episode is 1e+308"),
    (
        set_action("action", lambda old: old * np.nan),
        "its actions must be of shape (N, 18), up to 1099511627776",
    ),
    (set_action("action", lambda old: old[:, :17]), "they are of shape (255, 17)"),
    (set_action("offsets", lambda old: old[::-1]), "its offsets"),
]


@pytest.mark.parametrize(("damage", "sentence"), DAMAGE, ids=[sentence for _, sentence in DAMAGE])
def test_damage_is_one_sentence(
    damage: Callable[[Path], None], sentence: str, folder: Path
) -> None:
    damage(folder)
    with pytest.raises(ReadError) as refused:
        read_results(folder)
    assert sentence in str(refused.value)
    assert str(refused.value).isprintable()
