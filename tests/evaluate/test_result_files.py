"""Result folders that someone else made: damaged or hostile ones are refused in one sentence, before they cost much."""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.evaluate.results import ResultsError, read_results
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.report.example_runs import example_run

EVIL = "\x1b]0;evil\x07"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    example_run(tmp_path / "run", "run", 0.5, 4)
    return tmp_path / "run"


def set_head(**changes: object) -> Callable[[Path], None]:
    """Return a function that changes ``metrics.json``."""

    def change(folder: Path) -> None:
        head = json.loads((folder / "metrics.json").read_text())
        (folder / "metrics.json").write_text(json.dumps(head | changes))

    return change


def set_column(name: str, values: list[Any], kind: pa.DataType | None = None) -> Callable[[Path], None]:
    """Return a function that replaces a column of ``episodes.parquet``."""

    def change(folder: Path) -> None:
        table = pq.read_table(folder / "episodes.parquet")
        column = pa.array(values, kind or table.schema.field(name).type)
        pq.write_table(
            table.set_column(table.column_names.index(name), name, column),
            folder / "episodes.parquet",
            compression="none",
        )

    return change


def set_actions(**changes: Any) -> Callable[[Path], None]:
    """Return a function that replaces arrays of ``actions.npz`` by functions of the old ones."""

    def change(folder: Path) -> None:
        with np.load(folder / "actions.npz") as archive:
            arrays = dict(archive)
        np.savez(folder / "actions.npz", **arrays | {name: edit(arrays.get(name)) for name, edit in changes.items()})

    return change


def compressed_rows(folder: Path) -> None:
    """A run of equal values takes no place on disk: 65 kB once became 3 GB."""
    pq.write_table(pq.read_table(folder / "episodes.parquet"), folder / "episodes.parquet", compression="zstd")


def compressed_actions(folder: Path) -> None:
    """A third of a megabyte of zeros once became 360 MB."""
    with np.load(folder / "actions.npz") as archive:
        np.savez_compressed(folder / "actions.npz", **dict(archive))


def surplus_column(folder: Path) -> None:
    table = pq.read_table(folder / "episodes.parquet")
    table = table.append_column("surplus", pa.array([0] * len(table)))
    pq.write_table(table, folder / "episodes.parquet", compression="none")


def array_of_nothing(folder: Path) -> None:
    """Elements of no size take no place in the file: a list of them once had a billion entries."""
    with ZipFile(folder / "actions.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = b"{'descr': '|V0', 'fortran_order': False, 'shape': (1000000000,), }".ljust(117) + b"\n"
    members["seed.npy"] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with ZipFile(folder / "actions.npz", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def many_names(folder: Path) -> None:
    """A figure of as many kinds of motion would never be finished."""
    table = pa.concat_tables([pq.read_table(folder / "episodes.parquet").slice(0, 1)] * 300)
    kinds = pa.array([f"kind_{i}" for i in range(300)])
    table = table.set_column(table.column_names.index("kind"), "kind", kinds)
    pq.write_table(table, folder / "episodes.parquet", compression="none")
    set_head(n=300)(folder)


def text(content: str) -> Callable[[Path], None]:
    return lambda folder: (folder / "metrics.json").write_text(content) and None


DAMAGE: list[tuple[Callable[[Path], None], str]] = [
    (text("[]"), "not list"),
    (text("[" * 10**5), "RecursionError"),
    (text(" " * 2**25), "33554432 bytes are too many"),
    (set_head(n=0), "disagree"),
    (set_head(n="4"), "n must be of type int, got str"),
    (set_head(n=True), "n must be of type int, got bool"),
    *((set_head(**{key: None}), f"{key} must be of type str, got NoneType") for key in ("policy", "split", "capture")),
    (set_head(policy={"a": 1}), "policy must be of type str, got dict"),
    (set_head(extra=[1]), "extra must be of type dict, got list"),
    (set_head(extra={"n_obs_frames": float("nan")}), "NaN is no number of JSON"),
    (set_head(extra={"inference": 150.0}), "'async 150 ms', got 150.0"),
    (set_head(command=EVIL), r"printable, got '\x1b]0;evil\x07'"),
    (set_head(metrics={"S_loc\r": {}}), r"printable, got 'S_loc\r'"),
    (set_head(policy="x" * 5000), "4096 characters, got 5000"),
    (set_head(surplus=1), "unknown key 'surplus'"),
    (set_head(benchmark="v0"), f"episodes of benchmark 'v0' and '{BENCHMARK.version}'"),
    (compressed_rows, "must not be compressed"),
    (compressed_actions, "must not be compressed"),
    (surplus_column, "its column surplus"),
    (many_names, "kind may have 256 different texts, got 300"),
    (set_column("kind", ["lob", "x" * 10**6, "lob", "lob"]), "bytes are too many"),
    (set_column("kind", ["lob", "x" * 300, "lob", "lob"]), "kind may have 256 characters, got 300"),
    (set_column("kind", ["lob", None, "lob", "lob"]), "seed 1 has no kind"),
    (set_column("control_class", ["late"] * 3 + [EVIL]), "must be printable"),
    (set_column("control_class", ["late"] * 3 + ["standard"]), "control_class 'late' and 'standard'"),
    (set_column("S_loc", ["a"] * 4, pa.string()), "its column S_loc"),
    *(
        (set_column(name, [None] * 4), f"seed 0 has no {name}")
        for name, metric in METRICS.items()
        if not metric.condition
    ),
    (set_column("S_loc", [0.0, 1.0, 0.5, 1.0]), "seed 2 has the S_loc 0.5, which must be 0 or 1"),
    (set_column("E_loc", [0.0, 1.0, float("nan"), 1.0]), "seed 2 has the E_loc nan"),
    (set_column("E_loc", [0.0, 1.0, float("inf"), 1.0]), "seed 2 has the E_loc inf"),
    (set_column("Q_line", [0.0, 1.0, -3.0, 1.0]), "seed 2 has the Q_line -3.0, which must be -1 to 1"),
    (set_column("travel_u", [0.0, 1.0, 2.0, float("nan")]), "seed 3 has the travel_u nan"),
    (set_column("window_frames", [8, 8, 8, -8]), "has the window_frames -8"),
    (set_column("seed", [0, 1, 2, None]), "seed None has no seed"),
    (array_of_nothing, "seed must not be (1000000000,) |V0"),
    (set_actions(seed=lambda old: old + 1), "its seed are not those of"),
    (set_actions(window_frames=lambda old: old + 1), "its window_frames are not those of"),
    (set_actions(more=lambda _: np.zeros(3)), "it must hold action, offsets, seed, window_frames"),
    (set_actions(action=lambda old: old[:, :17]), "action must not be"),
    (set_actions(action=lambda old: old * np.float32("nan")), "not a finite number"),
    (set_actions(action=lambda old: old.astype(object)), "actions.npz is damaged"),
    (set_actions(action=lambda old: np.zeros((10**5, 18), np.float32)), "bytes are too many"),
    (set_actions(offsets=lambda old: old[::-1]), "offsets must rise from 0 to"),
    (set_actions(offsets=lambda old: old[:, None]), "offsets must not be"),
]


@pytest.mark.parametrize(("damage", "sentence"), DAMAGE, ids=[sentence for _, sentence in DAMAGE])
def test_damage_is_one_printable_sentence(damage: Callable[[Path], None], sentence: str, folder: Path) -> None:
    damage(folder)
    with pytest.raises(ResultsError) as refused:
        read_results(folder)
    assert sentence in str(refused.value)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize("name", ["metrics.json", "episodes.parquet", "actions.npz"])
def test_a_missing_cut_or_endless_file_is_named(folder: Path, name: str) -> None:
    whole = (folder / name).read_bytes()
    (folder / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ResultsError, match=rf"{name} is damaged"):
        read_results(folder)
    os.truncate(folder / name, 30 * 2**30)
    with pytest.raises(ResultsError, match=r"32212254720 bytes are too many"):
        read_results(folder)
    (folder / name).unlink()
    with pytest.raises(ResultsError, match=rf"{name} is missing"):
        read_results(folder)
    os.mkfifo(folder / name)
    with pytest.raises(ResultsError, match=rf"{name} is missing"):
        read_results(folder)


@pytest.mark.parametrize("name", ["metrics.json", "episodes.parquet", "actions.npz"])
def test_whatever_bytes_are_changed_it_reads_or_refuses_in_little_memory(folder: Path, name: str) -> None:
    whole, rng = (folder / name).read_bytes(), np.random.default_rng(0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(60):
        content = bytearray(whole)
        for place in rng.integers(len(whole), size=rng.integers(1, 5)):
            content[place] = rng.integers(256)
        (folder / name).write_bytes(content)
        message = ""
        try:
            read_results(folder)
        except ResultsError as refused:
            message = str(refused)
        assert message.isprintable()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000, "kB"


def test_a_damaged_folder_leaves_no_report(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    set_head(policy=None)(folder)
    goal = folder.parent / "page.html"
    assert cli.main(["report", str(folder), "--out", str(goal)]) == cli.BAD_INPUT
    assert capsys.readouterr().err.count("\n") == 1
    assert not goal.exists()
