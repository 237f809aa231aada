"""Datasets that LeRobot's own tools wrote anew give one sentence about what is gone."""

from __future__ import annotations

from pathlib import Path

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


@pytest.mark.slow  # LeRobot takes long to import
@pytest.mark.parametrize("name", EDITS)
def test_one_sentence_says_what_is_gone(tmp_path, name):
    source = write(tmp_path / "source", range(3), encoding=None)
    EDITS[name](source, tmp_path / "edited")
    (finding,) = verify(tmp_path / "edited", replayed=1)
    assert "written anew by another tool" in finding.message
    assert "meta/manifest.json and meta/histograms.json are gone" in finding.message
