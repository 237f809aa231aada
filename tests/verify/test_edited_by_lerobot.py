"""Datasets that LeRobot's own tools edited: a sentence says what is gone, and the rest is checked
as LeRobot's.
"""

import json
import shutil
from pathlib import Path

import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_tools import (
    convert_image_to_video_dataset,
    delete_episodes,
    merge_datasets,
    modify_tasks,
    recompute_stats,
    reencode_dataset,
    remove_feature,
    split_dataset,
)
from lerobot.datasets.video_utils import RGBEncoderConfig
from lerobot.scripts.lerobot_edit_dataset import OperationConfig, edit_dataset

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import open_dataset, read_episodes
from dynahoi_lerobot.dataset.store import frame_column
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.verify.command import verify
from tests.dataset.episodes import write
from tests.tools import edit_json, generated
from tests.verify.test_forgeries import DATA, INFO, VIDEO, column, told

pytestmark = pytest.mark.slow  # LeRobot takes long to import


def in_place(edit):
    return lambda source, out: edit(open_dataset(shutil.copytree(source, out)))


EDITS = {
    "delete": lambda source, out: delete_episodes(open_dataset(source), [1], out, "local/edited"),
    "split": lambda source, out: split_dataset(
        open_dataset(source), {out.name: [0, 2], "rest": [1]}, out.parent
    ),
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
    lost = "meta/manifest.json and the privileged tables"
    assert CHANGED.get(name, lost) in finding.message
    assert ("our columns" in finding.message) == (name in ("delete", "split")), "others copy them"
    if name in CHANGED:
        assert len(list(read_episodes(tmp_path / "edited"))) == 6, "the privileged tables stay"


def test_privileged_tables_of_other_episodes_are_found(dataset: Path, tmp_path: Path):
    EDITS["delete"](dataset, root := tmp_path / "edited")
    for folder in ("meta/privileged", "meta/privileged_episodes"):
        shutil.copytree(dataset / folder, root / folder)
    (finding,) = verify(root)
    assert "the privileged tables are those of other episodes" in finding.message


OPERATIONS = {
    "delete_episodes": ["--operation.episode_indices=[0, 3]"],
    "split": ['--operation.splits={"train": 0.5, "val": 0.5}'],
    "merge": ['--operation.repo_ids=["local/d", "local/d"]'],
    "remove_feature": ['--operation.feature_names=["next.success"]'],
    "modify_tasks": ["--operation.new_task=Catch it."],
    "convert_image_to_video": ["--operation.num_workers=1"],
    "recompute_stats": ["--operation.overwrite=true"],
    "reencode_videos": ["--operation.overwrite=true", "--operation.rgb_encoder.vcodec=h264"],
    "info": [],
}
IN_PLACE = ("modify_tasks", "recompute_stats", "reencode_videos")


@pytest.mark.nightly
@pytest.mark.parametrize("name", OperationConfig.get_known_choices())
def test_every_operation_of_lerobots_command_leaves_datasets_that_open(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    codec = "images" if name == "convert_image_to_video" else "h264"
    views = ("side",) if codec == "images" else ("side", "ego_depth")
    root = write(tmp_path / "d", range(6), encoding=Encoding(codec), views=views)
    words = [f"--operation.type={name}", *OPERATIONS[name]]
    words += [] if name in IN_PLACE else [f"--new_root={tmp_path / 'new'}"]
    if name == "merge":
        words += ["--new_repo_id=local/new", f"--operation.roots={json.dumps([str(root)] * 2)}"]
    else:
        words += ["--repo_id=local/d", f"--root={root}"]
    monkeypatch.setattr("sys.argv", ["lerobot-edit-dataset", *words])
    edit_dataset()
    made = [path.parents[1] for path in tmp_path.rglob("meta/info.json")]
    assert len(made) == {"split": 3, "info": 1, **dict.fromkeys(IN_PLACE, 1)}.get(name, 2)
    for folder in made:
        # not by `open_dataset`: the conversion leaves out the tasks of episodes, which it refuses
        opened = LeRobotDataset("local/d", root=folder)
        assert opened[len(opened) - 1]["action"].shape == (18,)


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
    sentence = f"{file} cannot be read: it has no column 'tasks'"
    assert any(sentence in message for message in found), found
    out = str(tmp_path / "x.gif")
    assert main(["view", "--dataset", str(converted), "--episode", "0", "--out", out]) == 2
    assert sentence in capsys.readouterr().err
