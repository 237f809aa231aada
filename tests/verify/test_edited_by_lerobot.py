"""Datasets that LeRobot's own tools edited: a sentence says what is gone, and the rest is checked
as LeRobot's.
"""

import shutil
from pathlib import Path

import pytest
from lerobot.datasets.dataset_tools import (
    convert_image_to_video_dataset,
    delete_episodes,
    merge_datasets,
    modify_tasks,
    recompute_stats,
    reencode_dataset,
    remove_feature,
)
from lerobot.datasets.video_utils import RGBEncoderConfig

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import open_dataset
from dynahoi_lerobot.dataset.store import frame_column
from dynahoi_lerobot.verify.command import verify
from tests.tools import edit_json, generated
from tests.verify.test_forgeries import DATA, INFO, VIDEO, column, told

pytestmark = pytest.mark.slow  # LeRobot takes long to import


def in_place(edit):
    return lambda source, out: edit(open_dataset(shutil.copytree(source, out)))


EDITS = {
    "delete": lambda source, out: delete_episodes(open_dataset(source), [1], out, "local/edited"),
    "merge": lambda source, out: merge_datasets(
        [open_dataset(source), open_dataset(source)], "local/edited", out
    ),
    "remove a feature": lambda source, out: remove_feature(
        open_dataset(source), "next.success", out, "local/edited"
    ),
    "tasks": in_place(lambda dataset: modify_tasks(dataset, new_task="Catch it.")),
    "re-encode": in_place(
        lambda dataset: reencode_dataset(dataset, RGBEncoderConfig(vcodec="h264", crf=30))
    ),
    "statistics": in_place(recompute_stats),
}
CHANGED = {
    "tasks": "meta/tasks.parquet",
    "re-encode": "videos/",
    "statistics": "meta/stats.json has changed",
}
"""What is named after an edit in place; others leave no manifest."""


@pytest.mark.parametrize("name", EDITS)
def test_one_sentence_says_what_was_edited_or_is_gone(dataset: Path, tmp_path: Path, name: str):
    EDITS[name](dataset, tmp_path / "edited")
    (finding,) = verify(tmp_path / "edited", replayed=1)
    assert finding.message.startswith("edited: ")
    assert CHANGED.get(name, "meta/manifest.json is gone") in finding.message
    assert ("our columns" in finding.message) == (name == "delete"), "the others copy them"


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


def test_quantiles_that_are_not_those_of_the_actions_are_said(dataset: Path, tmp_path: Path):
    EDITS["delete"](dataset, tmp_path / "edited")
    (before,) = verify(tmp_path / "edited")
    assert "q01" not in before.message
    above = frame_column(tmp_path / "edited", "action").max(axis=0) + 1

    def average(stats: dict) -> None:
        stats["action"]["q01"] = above.tolist()

    edit_json(tmp_path / "edited/meta/stats.json", average)
    (finding,) = verify(tmp_path / "edited")
    assert "100% of the numbers in 'action' lie outside" in finding.message


def test_a_column_that_lerobots_conversion_leaves_out_is_named_with_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    words = ("--image-size", "32", "--codec", "images", "--motions", "constant", "--episodes", "1")
    source = generated(tmp_path / "images", *words)
    converted = tmp_path / "converted"
    convert_image_to_video_dataset(open_dataset(source), converted, "local/converted")
    found = [finding.message for finding in verify(converted)]
    file = converted / "meta/episodes/chunk-000/file-000.parquet"
    assert any(f"{file} has no column 'tasks'" in message for message in found), found
    out = str(tmp_path / "x.gif")
    assert main(["view", "--dataset", str(converted), "--episode", "0", "--out", out]) == 2
    assert f"{file} has no column 'tasks'" in capsys.readouterr().err
