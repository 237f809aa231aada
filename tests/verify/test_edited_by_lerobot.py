"""Datasets that LeRobot's own tools wrote anew give a sentence about what is gone, and are checked as LeRobot's."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, remove_feature

from dynahoi_lerobot.verify.runner import verify
from tests.dataset.episodes import write


def opened(root: Path) -> LeRobotDataset:
    return LeRobotDataset(f"local/{root.name}", root=root)


EDITS = {
    "delete": lambda source, out: delete_episodes(opened(source), [1], out, "local/edited"),
    "merge": lambda source, out: merge_datasets([opened(source), opened(source)], "local/edited", out),
    "remove a feature": lambda source, out: remove_feature(opened(source), "target.contacts", out, "local/edited"),
}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four episodes with video."""
    return write(tmp_path_factory.mktemp("ours") / "source", range(4))


@pytest.mark.slow  # LeRobot takes long to import
@pytest.mark.parametrize("name", EDITS)
def test_one_sentence_says_what_is_gone(source: Path, tmp_path: Path, name: str):
    EDITS[name](source, tmp_path / "edited")
    (finding,) = verify(tmp_path / "edited", replayed=1)
    assert "written anew by another tool" in finding.message
    assert "meta/manifest.json and meta/histograms.json are gone" in finding.message


def add_episode(root: Path) -> None:
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps(info | {"total_episodes": 9}))


def shift_times(root: Path) -> None:
    (path,) = (root / "data").glob("*/*.parquet")
    table = pq.read_table(path)
    later = pc.add(table["timestamp"], pa.scalar(0.01, pa.float32()))
    pq.write_table(table.set_column(table.schema.get_field_index("timestamp"), "timestamp", later), path)


def cut_video(root: Path) -> None:
    (path,) = (root / "videos").glob("*/*/*.mp4")
    path.write_bytes(path.read_bytes()[:-100])


DAMAGES = {"counts": add_episode, "timestamps": shift_times, "videos": cut_video}


@pytest.mark.slow
@pytest.mark.parametrize("check", DAMAGES)
def test_damage_that_lerobots_format_shows_is_found(source: Path, tmp_path: Path, check: str):
    EDITS["delete"](source, tmp_path / "edited")
    DAMAGES[check](tmp_path / "edited")
    found = {finding.check for finding in verify(tmp_path / "edited")}
    assert found == {"reading", check}
