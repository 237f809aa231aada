"""Result folders that someone else made: damaged or hostile ones end in one sentence, and give nothing away."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.evaluate.gif import write_gif
from dynahoi_lerobot.report import page, render_report
from dynahoi_lerobot.report.clips import find_clips
from dynahoi_lerobot.report.entries import read_entries
from dynahoi_lerobot.report.figures.base import FIGURES
from tests.report.example_runs import example_run


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


DAMAGE: list[tuple[Callable[[Path], None], str]] = [
    (lambda folder: (folder / "metrics.json").write_text("[]"), "it must hold an object, not list"),
    (lambda folder: (folder / "metrics.json").write_text("[" * 10**5), "RecursionError"),
    (set_head(n=0), "it has 4 rows"),
    (set_head(n="4"), "n must be of type int, got str"),
    (set_head(policy={"a": 1}), "policy must be of type str, got dict"),
    (set_head(extra=[1]), "extra must be of type dict, got list"),
    (set_head(extra="x"), "extra must be of type dict, got str"),
    (set_head(extra={"n_obs_frames": float("nan")}), "NaN is no number of JSON"),
    (set_head(extra={"inference": 150.0}), "inference must be a text such as 'async 150 ms', got 150.0"),
    (set_head(fingerprint="0\x1b[8m\n1"), r"its texts must be printable, got '0\x1b[8m\n1'"),
    (set_head(command="\x1b]0;evil\x07"), "its texts must be printable"),
    (set_head(policy="x" * 5000), "may have 4096 characters, got 5000"),
    (set_head(surplus=1), "the unknown key 'surplus'"),
    (compressed_rows, "must not be compressed"),
    (compressed_actions, "must not be compressed"),
    (surplus_column, "its column surplus is not one of"),
    (set_column("kind", ["lob", "x" * 10**6, "lob", "lob"]), "bytes are too many"),
    (set_column("kind", ["lob", "x" * 300, "lob", "lob"]), "kind may have 256 characters, got 300"),
    (set_actions(seed=lambda old: old + 1), "its seeds are not those of"),
    (set_actions(more=lambda _: np.zeros(3)), "it must hold action, offsets, seed, window_frames"),
    (set_head(metrics={"S_loc\r": {}}), r"its texts must be printable, got 'S_loc\r'"),
    (lambda folder: (folder / "metrics.json").write_text(" " * 2**25), "33554432 bytes are too many"),
    (set_column("S_loc", ["a"] * 4, pa.string()), "its column S_loc is not one of"),
    (set_column("S_loc", [0.0, 1.0, 0.5, 1.0]), "seed 2 has the S_loc 0.5, which must be 0 or 1"),
    (set_column("E_loc", [0.0, 1.0, float("nan"), 1.0]), "seed 2 has the E_loc nan, which must be 0 to inf"),
    (set_column("E_loc", [0.0, 1.0, float("inf"), 1.0]), "seed 2 has the E_loc inf"),
    (set_column("Q_line", [0.0, 1.0, -3.0, 1.0]), "seed 2 has the Q_line -3.0, which must be -1 to 1"),
    (set_column("kind", ["lob", None, "lob", "lob"]), "seed 1 has no kind"),
    (set_column("travel_u", [0.0, 1.0, 2.0, float("nan")]), "seed 3 has the travel_u nan"),
    (set_column("seed", [0, 1, 2, None]), "seed None has no seed"),
    (set_actions(action=lambda old: old[:, :17]), r"actions must be (K, 18) float32, not"),
    (set_actions(action=lambda old: old * np.float32("nan")), "an action is not a finite number"),
    (set_actions(action=lambda old: old.astype(object)), "actions.npz is damaged"),
    (set_actions(action=lambda old: np.zeros((10**5, 18), np.float32)), "bytes are too many for 4 episodes"),
    (set_actions(offsets=lambda old: old[::-1]), "offsets must rise from 0 to"),
    (set_actions(offsets=lambda old: old[:, None]), "offsets must be (N + 1,) integers"),
]


@pytest.mark.parametrize(("damage", "sentence"), DAMAGE, ids=[sentence for _, sentence in DAMAGE])
def test_damage_is_one_sentence_and_leaves_no_page(
    damage: Callable[[Path], None], sentence: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(folder)
    goal = folder.parent / "page.html"
    assert cli.main(["report", str(folder), "--out", str(goal)]) == cli.BAD_INPUT
    message = capsys.readouterr().err.strip()
    assert sentence in message
    assert message.count("\n") == 0
    assert not goal.exists()


def test_odd_but_honest_values_still_make_a_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = [FIGURES[name] for name in ("data", "obs-frames", "data-scaling", "stages")]
    monkeypatch.setattr(page, "in_order", lambda: drawn)
    set_head(extra={"n_obs_frames": 10**400, "data_fraction": "half", "recipe": 7})(folder)
    set_column("tier", ["new", "kinematic", "", "<b>"])(folder)
    set_column("stage", ["?", "missed", "", "<b>"])(folder)
    assert "<b>" not in render_report([folder], folder.parent / "page.html").read_text()


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "secret.gif"
    path.write_bytes(b"GIF89a secret")
    return path


def test_only_gifs_of_the_folder_itself_are_embedded(folder: Path, secret: Path) -> None:
    write_gif(folder / "true.gif", np.zeros((2, 8, 8, 3), np.uint8))
    (folder / "link.gif").symlink_to(secret)
    (folder / "text.gif").write_text("no GIF")
    (folder / "folder.gif").mkdir()
    with (folder / "huge.gif").open("wb") as file:
        file.write(b"GIF89a")
        file.truncate(10**8)
    (group,) = find_clips(read_entries([folder]))
    assert [name for name, _ in group.clips] == ["true"]
    assert group.left_out == 0
