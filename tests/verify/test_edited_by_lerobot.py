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
)
from lerobot.scripts.lerobot_edit_dataset import OperationConfig

from dynahoi_lerobot.dataset import open_dataset, read_episodes
from dynahoi_lerobot.dataset.store import frame_column
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.verify.command import verify
from tests.dataset.episodes import write
from tests.tools import dynahoi, edit_json, generated, run
from tests.verify.test_forgeries import DATA, INFO, VIDEO, column, told

pytestmark = pytest.mark.slow  # LeRobot takes long to import


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
IN_PLACE = {
    "modify_tasks": "meta/tasks.parquet",
    "recompute_stats": "meta/stats.json has changed",
    "reencode_videos": "videos/",
}
"""What is named after an edit in place; others leave no manifest."""
COLUMNS_GONE = ("delete_episodes", "split", "convert_image_to_video")
"""Edits that leave out our columns of episodes; others copy them."""


@pytest.mark.parametrize("name", OperationConfig.get_known_choices())
def test_one_sentence_says_what_lerobots_command_has_edited_and_the_rest_opens(
    name: str, tmp_path: Path
):
    codec = "images" if name == "convert_image_to_video" else "h264"
    views = ("side",) if codec == "images" else ("side", "ego_depth")
    root = write(tmp_path / "d", range(6), encoding=Encoding(codec), views=views)
    out = root if name in IN_PLACE else tmp_path / "new"
    words = [f"--operation.type={name}", *OPERATIONS[name], f"--new_root={out}"]
    if name == "merge":
        words += ["--new_repo_id=local/new", f"--operation.roots={json.dumps([str(root)] * 2)}"]
    else:
        words += ["--repo_id=local/d", f"--root={root}"]
    run(["lerobot-edit-dataset", *words])
    made = {path.parents[1] for path in tmp_path.rglob("meta/info.json")}
    edited = made if name in IN_PLACE else made - {root}
    assert len(edited) == {"split": 2, "info": 0}.get(name, 1)
    for folder in edited:
        # not by `open_dataset`: the conversion leaves out the tasks of episodes, which it refuses
        opened = LeRobotDataset("local/d", root=folder)
        assert opened[len(opened) - 1]["action"].shape == (18,)
        told = [finding.message for finding in verify(folder, replayed=1)]
        assert told[0].startswith("edited: ")
        assert len(told) == 1 or name == "convert_image_to_video"
        lost = "meta/manifest.json and the privileged tables"
        assert IN_PLACE.get(name, lost) in told[0]
        assert ("our columns" in told[0]) == (name in COLUMNS_GONE)
        if name in IN_PLACE:
            assert len(list(read_episodes(folder))) == 6, "the privileged tables stay"


@pytest.fixture
def shorter(dataset: Path, tmp_path: Path) -> Path:
    """A dataset of which LeRobot has deleted an episode."""
    delete_episodes(open_dataset(dataset), [1], tmp_path / "edited", "local/edited")
    return tmp_path / "edited"


def test_privileged_tables_of_other_episodes_are_found(dataset: Path, shorter: Path):
    for folder in ("meta/privileged", "meta/privileged_episodes"):
        shutil.copytree(dataset / folder, shorter / folder)
    (finding,) = verify(shorter)
    assert "the privileged tables are those of other episodes" in finding.message


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
def test_damage_that_lerobots_format_shows_is_found(shorter: Path, damage):
    damage(shorter)
    assert {finding.check for finding in verify(shorter)} == {"files", "format"}


def test_quantiles_that_are_not_those_of_the_actions_are_said(shorter: Path):
    (before,) = verify(shorter)
    assert "q01" not in before.message
    above = (frame_column(shorter, "action").max(axis=0) + 1).tolist()
    edit_json(shorter / "meta/stats.json", lambda stats: stats["action"].update(q01=above))
    (finding,) = verify(shorter)
    assert "100% of the numbers in 'action' lie outside" in finding.message


def test_a_column_that_lerobots_conversion_leaves_out_is_named_with_its_file(tmp_path: Path):
    words = ("--image-size", "32", "--codec", "images", "--motions", "constant", "--episodes", "1")
    source = generated(tmp_path / "images", *words)
    converted = tmp_path / "converted"
    convert_image_to_video_dataset(open_dataset(source), converted, "local/converted")
    found = [finding.message for finding in verify(converted)]
    file = converted / "meta/episodes/chunk-000/file-000.parquet"
    sentence = f"{file} cannot be read: it has no column 'tasks'"
    assert any(sentence in message for message in found), found
    words = ("--dataset", converted, "--episode", 0, "--out", tmp_path / "x.gif")
    assert sentence in dynahoi("view", *words, code=2).err
