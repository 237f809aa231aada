"""A result folder: what is in it, that it comes back unchanged, and that an interrupted run loses
nothing.
"""

import json
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.reading import LeftOut, ReadError
from dynahoi_lerobot.evaluate.compare import compare
from dynahoi_lerobot.evaluate.results import (
    SCHEMA,
    Results,
    command_line,
    kept_results,
    read_results,
)
from dynahoi_lerobot.evaluate.summary import wilson
from dynahoi_lerobot.evaluate.table import columns_for
from dynahoi_lerobot.metrics import METRICS, Metric
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from tests.evaluate.test_replay_results import set_head
from tests.synthetic import run_info, synthetic_episode, write_results
from tests.tools import edit_json

INFO = run_info(extra={"n_obs_frames": 5})


EMPTY = {"value": None, "low": None, "high": None, "unit": "fraction", "n": 0}


def test_the_command_can_be_pasted(monkeypatch: pytest.MonkeyPatch):
    words = ["evaluate", "--policy", "hold", "--out", "my results"]
    monkeypatch.setattr("sys.argv", ["/bin/dynahoi", *words])
    assert shlex.split(command_line()) == ["dynahoi", *words]


def episodes(count: int = 6):
    """Yield episodes of which every third misses by 5 cm, of two kinds and different lengths."""
    for seed in range(count):
        episode = synthetic_episode(
            seed, frames=40 + seed, image_size=None, miss_m=0.05 * (seed % 3 == 0)
        )
        yield changed(episode, {"motion": ("constant", "lob")[seed % 2]})


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
    assert head["schema"] == SCHEMA
    assert head["metrics"]["S_hold"] == EMPTY
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


def test_episodes_lie_in_the_order_of_the_split_in_whichever_order_they_end(tmp_path: Path):
    played = list(episodes(9))
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(9)
        write_results(tmp_path / str(seed), [played[i] for i in order[:4]], INFO)
        results = Results.resumed(tmp_path / str(seed), INFO).plus([played[i] for i in order[4:]])
        results.write()
    whole = write_results(tmp_path / "whole", played, INFO)
    for path in whole.folder.iterdir():
        for seed in range(3):
            assert (tmp_path / str(seed) / path.name).read_bytes() == path.read_bytes()
    assert [row["seed"] for row in read_results(whole.folder).rows] == list(range(9))


BOTH = ("episodes.parquet", "actions.npz")


@pytest.mark.parametrize("renamed", [(), BOTH[:1], BOTH[1:], BOTH, (*BOTH, "metrics.json")])
@pytest.mark.parametrize("before", [(), (1, 4, 8)])
def test_an_interrupted_run_resumes_from_the_episodes_that_both_files_hold(
    tmp_path: Path, before: tuple[int, ...], renamed: tuple[str, ...]
):
    """The files of a later save are renamed one after the other, over those of an earlier one."""
    played = list(episodes(9))
    part = tmp_path / "part"
    part.mkdir()
    if before:
        write_results(part, [played[i] for i in before], INFO)
    later = (0, 1, 3, 4, 6, 8)
    write_results(tmp_path / "later", [played[i] for i in later], INFO)
    for name in renamed:
        shutil.copy(tmp_path / "later" / name, part / name)
    resumed = Results.resumed(part, INFO)
    assert resumed.seeds == set(later if set(BOTH) <= set(renamed) else before)
    resumed.plus([episode for episode in played if episode.meta.seed not in resumed.seeds]).write()
    whole = write_results(tmp_path / "whole", played, INFO)
    assert read_results(part).rows == whole.rows
    assert all(map(np.array_equal, read_results(part).actions, whole.actions))


def test_metrics_that_do_not_apply_are_null(tmp_path: Path):
    contact = [changed(episode, {"capture": "contact"}) for episode in episodes(3)]
    folder = tmp_path / "contact"
    write_results(folder, contact, run_info(capture="contact"))
    head = json.loads((folder / "metrics.json").read_text())
    table = pq.read_table(folder / "episodes.parquet")
    for name in ("S_joint", "S_joint_paper", "S_gra", "grasp_strict"):
        assert head["metrics"][name] == EMPTY
        assert table[name].to_pylist() == [None] * 3
    assert None not in table["S_hold"].to_pylist()
    assert read_results(folder).rows[0]["S_joint"] is None


# -- metrics that come and go ----------------------------------------------------------------------


def test_a_metric_of_ones_own_is_stored_and_older_results_stay_readable(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    before = read_results(folder)
    own = Metric("V_palm", lambda _: 0.25, "m/s", "lower", "mean", (0.0, 2.0))
    monkeypatch.setitem(METRICS._entries, "V_palm", own)
    older = read_results(folder)
    assert older.rows == before.rows, "what was not measured is missing"
    assert older.summary["V_palm"].n == 0
    assert older.as_json() == before.as_json()
    newer = write_results(folder.parent / "newer", episodes(), INFO)
    assert {row["V_palm"] for row in read_results(newer.folder).rows} == {0.25}
    assert compare(older, newer, "V_palm") is None
    assert compare(older, newer, "S_loc").n == 6
    assert columns_for([older, newer]) == columns_for([before])


# -- the schema ------------------------------------------------------------------------------------


@pytest.mark.parametrize("schema", [SCHEMA + 1, True, None])
def test_another_schema_is_refused_by_a_sentence_that_names_both(folder: Path, schema):
    set_head(schema=schema)(folder)
    told = rf"schema {schema!r}.*reads schema {SCHEMA}.*evaluate again"
    with pytest.raises(ReadError, match=told):
        read_results(folder)


def test_a_run_under_another_schema_or_of_other_weights_is_not_resumed(folder: Path):
    other = replace(INFO, extra=INFO.extra | {"weights": {"base/model.safetensors": "c" * 64}})
    assert INFO.task() != other.task()
    (folder / "plan.json").write_text(json.dumps(INFO.task() | {"schema": SCHEMA - 1}))
    with pytest.raises(FileExistsError, match="other schema"), kept_results(folder, INFO):
        pass


def test_new_keys_and_columns_and_metrics_of_packages_that_are_removed_change_nothing(folder: Path):
    before = read_results(folder)
    set_head(later={"a": 1})(folder)
    edit_json(folder / "metrics.json", lambda head: head["metrics"].update(later=EMPTY))
    set_column("later", [0.25] * 6)(folder)
    with pytest.warns(LeftOut, match=r"run/episodes\.parquet: later"):
        after = read_results(folder)
    assert (after.rows, after.info) == (before.rows, before.info)


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


DAMAGE: list[tuple[Callable[[Path], None], str]] = [
    (set_head(n=0), "disagree"),
    (set_head(benchmark="v0"), f"episodes of benchmark 'v0' and '{BENCHMARK_ID}'"),
    (set_column("S_loc", ["a"] * 6), "its column S_loc"),
    (
        set_column("control_class", ["late"] * 5 + ["standard"]),
        "control_class 'late' and 'standard'",
    ),
    (set_action("seed", lambda old: old + 1), "its seeds are not those of"),
    (set_action("offsets", lambda old: old[::-1]), "its offsets do not divide its actions"),
    (set_action("offsets", lambda old: old[:-1]), "its offsets do not divide its actions"),
    (set_column("window_frames", [40] * 6), "seed 0 has 40 commands, and window_frames is 40"),
    (set_column("E_loc", [1e308] * 6), "it says E_loc of an episode is 1e+308"),
    (
        set_action("action", lambda old: old * np.nan),
        "its actions must be of shape (N, 18), up to 1099511627776",
    ),
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
