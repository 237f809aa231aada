"""What no policy may see is in tables of its own: read by us, by pandas and by key, and refused
where another tool has left it behind.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dynahoi_lerobot.core.features import privileged_features
from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.dataset import episode_column, frame_column, open_dataset, read_episodes
from dynahoi_lerobot.dataset.manifest import SCHEMA
from dynahoi_lerobot.dataset.merge import copy_subset, merge
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from tests.dataset.episodes import varied_episode, write
from tests.tools import edit_json

TABLES = ("meta/privileged", "meta/privileged_episodes")


def test_pandas_reads_arrays_of_the_features_shapes(dataset: Path):
    episodes = list(read_episodes(dataset))
    frames, rows = (pd.read_parquet(dataset / folder) for folder in TABLES)
    poses = np.concatenate([episode.target_pose_h for episode in episodes])
    np.testing.assert_array_equal(np.stack(frames["target.pose"].tolist()), poses)
    for row, episode in zip(rows.itertuples(), episodes, strict=True):
        np.testing.assert_array_equal(row.open_joints, episode.open_joints)
        np.testing.assert_array_equal(np.stack(row.target_path), episode.target_path_h)
        assert row.object_mass == episode.object_mass_kg
    keys = [(i, frame) for i, episode in enumerate(episodes) for frame in range(len(episode))]
    assert list(zip(frames["episode_index"], frames["frame_index"], strict=True)) == keys


def test_every_privileged_column_is_in_one_of_both_tables_and_in_no_other(dataset: Path):
    columns = [set(pd.read_parquet(dataset / folder)) for folder in TABLES]
    keys = {feature.key for feature in privileged_features()}
    assert columns[0] | columns[1] == keys | {"episode_index", "frame_index"}
    assert columns[0] & columns[1] == {"episode_index"}
    for folder in ("meta/episodes", "data"):
        assert not keys & set(pd.read_parquet(dataset / folder))


def test_an_episode_is_found_in_any_of_several_files(tmp_path: Path):
    limits = FileLimits(data_mb=0.05, chunk_files=1)
    root = write(tmp_path / "d", range(300), image_size=0, limits=limits)
    store = Store(root)
    privileged = (store.privileged.frames, store.privileged.episodes)
    assert min(len(table.files) for table in privileged) > 1
    for index, read in enumerate(read_episodes(root)):
        np.testing.assert_array_equal(read.target_pose_h, varied_episode(index, 0).target_pose_h)
    for index in (0, 255, 256, 299):
        (episode,) = read_episodes(root, [index])
        np.testing.assert_array_equal(episode.fingertips, varied_episode(index, 0).fingertips)
        assert len(episode.target_path_h) == len(varied_episode(index, 0).target_path_h)


def of_others(root: Path, tmp_path: Path) -> None:
    """Put the tables of another dataset, with fewer episodes, into the place of its own."""
    other = write(tmp_path / "other", range(4))
    for folder in TABLES:
        shutil.rmtree(root / folder)
        shutil.copytree(other / folder, root / folder)


def without(root: Path, tmp_path: Path) -> None:
    for folder in TABLES:
        shutil.rmtree(root / folder)


@pytest.mark.parametrize(
    ("change", "said"), [(without, "no privileged tables"), (of_others, "of other episodes")]
)
def test_tables_that_an_edit_has_lost_or_left_behind_are_not_read(
    dataset: Path, tmp_path: Path, change, said: str
):
    root = shutil.copytree(dataset, tmp_path / "d")
    change(root, tmp_path)
    for read in (
        lambda: list(read_episodes(root)),
        lambda: list(read_episodes(root, [1])),
        lambda: frame_column(root, "target.pose"),
        lambda: frame_column(root, "home_position"),
        lambda: episode_column(root, "target_path"),
        lambda: copy_subset(root, tmp_path / "copy", [0]),
    ):
        with pytest.raises(ValueError, match=said) as refused:
            read()
        assert "LeRobot's tools" in str(refused.value)
    assert not (tmp_path / "copy").exists()
    assert len(frame_column(root, "action")) == len(open_dataset(root)), "LeRobot's are as before"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda content: content.update(schema=SCHEMA + 1), f"schema {SCHEMA + 1}"),
        (lambda content: content.update(schema=True), "schema True"),
        (lambda content: content.pop("schema"), "no schema"),
    ],
)
def test_another_schema_is_refused_by_a_sentence_that_names_both(
    dataset: Path, tmp_path: Path, change: Callable[[dict], object], told: str
):
    root = shutil.copytree(dataset, tmp_path / "d")
    edit_json(root / "meta/manifest.json", change)
    for read in (
        lambda: list(read_episodes(root)),
        lambda: frame_column(root, "action"),
        lambda: open_dataset(root),
        lambda: merge([root], tmp_path / "merged"),
    ):
        with pytest.raises(ReadError, match=f"{told}.* reads schema {SCHEMA}"):
            read()
