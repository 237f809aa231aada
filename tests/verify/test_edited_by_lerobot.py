"""Datasets that LeRobot's own tools edited: a sentence says what is gone, and the rest is checked as LeRobot's."""

import shutil
from pathlib import Path

import pytest
from lerobot.datasets.dataset_tools import (
    delete_episodes,
    merge_datasets,
    modify_tasks,
    recompute_stats,
    reencode_dataset,
    remove_feature,
    split_dataset,
)
from lerobot.datasets.video_utils import RGBEncoderConfig

from dynahoi_lerobot.dataset import open_dataset
from dynahoi_lerobot.verify.command import verify
from tests.verify.test_forgeries import DATA, INFO, VIDEO, column, told

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
    assert finding.message.startswith("edited: meta/manifest.json is gone")
    assert ("our columns" in finding.message) == (name in ("delete", "split")), "the others copy them"


def edit_in_place(edit):
    return lambda source, out: edit(open_dataset(shutil.copytree(source, out)))


IN_PLACE = {
    "tasks": (edit_in_place(lambda dataset: modify_tasks(dataset, new_task="Catch it.")), "meta/tasks.parquet"),
    "re-encode": (
        edit_in_place(lambda dataset: reencode_dataset(dataset, RGBEncoderConfig(vcodec="h264", crf=30))),
        "videos/",
    ),
    "statistics": (edit_in_place(recompute_stats), "meta/stats.json has changed"),
}


@pytest.mark.parametrize("name", IN_PLACE)
def test_one_sentence_says_what_was_edited_in_place(dataset: Path, tmp_path: Path, name: str):
    edit, changed = IN_PLACE[name]
    edit(dataset, tmp_path / "edited")
    (finding,) = verify(tmp_path / "edited")
    assert finding.message.startswith("edited: ")
    assert changed in finding.message


def cut_video(root: Path) -> None:
    (root / VIDEO).write_bytes((root / VIDEO).read_bytes()[:-100])


@pytest.mark.parametrize(
    "damage",
    [
        told(INFO, "total_episodes", value=3),
        column(DATA, "timestamp", lambda times: [t + 0.05 for t in times]),
        cut_video,
    ],
)
def test_damage_that_lerobots_format_shows_is_found(dataset: Path, tmp_path: Path, damage):
    EDITS["delete"](dataset, tmp_path / "edited")
    damage(tmp_path / "edited")
    assert {finding.check for finding in verify(tmp_path / "edited")} == {"files", "format"}
