"""``generate --privileged-columns episodes``: nothing is lost, and loaders do not read it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.subset import copy_subset
from dynahoi_lerobot.metrics import measure
from tests.dataset.lerobot_api import open_dataset
from tests.verify.forgery import sign

MOVED = {"target.pose", "target.velocity", "target.contacts", "intercept.position", "intercept.time"}
MOVED |= {"localized", "captured"}
READ = {"next.reward", "next.done", "next.success"}


def generate(root: Path, *words: str) -> Path:
    small = ["--episodes", "2", "--image-size", "32", "--motions", "constant,lob"]
    assert main(["generate", "--root", str(root), *small, *words]) == 0
    return root


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("data")
    return {
        "frames": generate(folder / "frames"),
        "episodes": generate(folder / "episodes", "--privileged-columns", "episodes"),
    }


def test_lerobot_reads_rows_without_them(roots: dict[str, Path]) -> None:
    full, lean = open_dataset(roots["frames"]), open_dataset(roots["episodes"])
    assert set(full[0]) - set(lean[0]) == MOVED
    assert set(lean[0]) >= READ
    assert not [name for name in lean.meta.episodes.column_names if name.startswith("stats/")]
    np.testing.assert_array_equal(full[7]["action"], lean[7]["action"])


def test_episodes_and_metrics_are_the_same(roots: dict[str, Path]) -> None:
    for one, other in zip(read_episodes(roots["frames"]), read_episodes(roots["episodes"]), strict=True):
        for field in fields(one):
            if field.name not in ("meta", "images"):
                np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), field.name)
        assert measure(one) == measure(other)


def test_verify_and_replay_and_copies_know_them(roots: dict[str, Path], tmp_path: Path) -> None:
    assert main(["verify", str(roots["episodes"]), "--decode", "all", "--replay", "1"]) == 0
    copy_subset(roots["episodes"], tmp_path / "copy", [1])
    assert main(["verify", str(tmp_path / "copy")]) == 0
    (copied,), (_, second) = read_episodes(tmp_path / "copy"), read_episodes(roots["episodes"])
    np.testing.assert_array_equal(copied.target_pose, second.target_pose)


def test_verify_finds_a_changed_one(roots: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    (path,) = roots["episodes"].glob("meta/episodes/*/*.parquet")
    whole, table = path.read_bytes(), pq.read_table(path)
    poses = table["stats/target.pose"].to_pylist()
    poses[0][7 * 4] += 0.05
    changed = pa.array(poses, table.schema.field("stats/target.pose").type)
    pq.write_table(table.set_column(table.column_names.index("stats/target.pose"), "stats/target.pose", changed), path)
    sign(roots["episodes"])
    code = main(["verify", str(roots["episodes"]), "--decode", "0"])
    path.write_bytes(whole)
    sign(roots["episodes"])
    assert code == 1
    assert "motion: episode 0" in capsys.readouterr().out


def test_another_place_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "--root", str(tmp_path / "d"), "--episodes", "1", "--privileged-columns", "nowhere"]) == 2
    assert "is 'nowhere'; it must be frames or episodes" in capsys.readouterr().err
