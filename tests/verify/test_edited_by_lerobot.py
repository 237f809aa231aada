"""Datasets that LeRobot's own tools edited: a sentence says what is gone, and the rest is checked as LeRobot's."""

import re
import shutil
from pathlib import Path

import pytest
from lerobot.datasets.dataset_tools import (
    delete_episodes,
    merge_datasets,
    recompute_stats,
    remove_feature,
    split_dataset,
)

from dynahoi_lerobot.dataset import open_dataset
from dynahoi_lerobot.verify.command import verify
from tests.verify.test_verify import FORMAT, VIDEO

pytestmark = pytest.mark.slow  # LeRobot takes long to import


def split(source: Path, out: Path) -> None:
    split_dataset(open_dataset(source), {"a": [0, 1, 2], "b": [3, 4, 5]}, out.parent)
    (out.parent / "a").rename(out)


EDITS = {
    "delete": lambda source, out: delete_episodes(open_dataset(source), [1], out, "local/edited"),
    "merge": lambda source, out: merge_datasets([open_dataset(source), open_dataset(source)], "local/edited", out),
    "split": split,
    "remove a feature": lambda source, out: remove_feature(open_dataset(source), "next.success", out, "local/edited"),
}


@pytest.mark.parametrize("name", EDITS)
def test_one_sentence_says_what_is_gone(dataset: Path, tmp_path: Path, name: str):
    EDITS[name](dataset, tmp_path / "edited")
    (finding,) = verify(tmp_path / "edited", replayed=1)
    assert "meta/manifest.json is gone" in finding.message
    assert ("our columns" in finding.message) == (name in ("delete", "split")), "the others copy them"


def test_statistics_that_were_computed_anew_are_a_file_that_has_changed(dataset: Path, tmp_path: Path):
    copy = shutil.copytree(dataset, tmp_path / "copy")
    recompute_stats(open_dataset(copy))
    findings = verify(copy)
    (changed,) = (finding.message for finding in findings if finding.check == "files")
    assert "meta/stats.json has changed" in changed
    for finding in (finding for finding in findings if finding.check != "files"):
        numbers = re.findall(r"[0-9][0-9.e+-]*[0-9]|[0-9]", finding.message)
        assert len(set(numbers)) == len(numbers), f"it tells the same number twice: {finding}"


def cut_video(root: Path) -> None:
    (root / VIDEO).write_bytes((root / VIDEO).read_bytes()[:-100])


@pytest.mark.parametrize("damage", [FORMAT["more episodes"], FORMAT["times that are shifted"], cut_video])
def test_damage_that_lerobots_format_shows_is_found(dataset: Path, tmp_path: Path, damage):
    EDITS["delete"](dataset, tmp_path / "edited")
    damage(tmp_path / "edited")
    assert {finding.check for finding in verify(tmp_path / "edited")} == {"files", "format"}
