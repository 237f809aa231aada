"""Episodes on disk: written, read, merged and copied, always with the same bytes; their card."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import CAMERA_KEY, COMMAND_NAMES, FEATURES, privileged_features
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.dataset import (
    episode_column,
    frame_column,
    open_dataset,
    read_episodes,
    write_episodes,
)
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.merge import copy_subset, merge
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import CODECS, Encoding
from tests.dataset.episodes import varied_episode, write
from tests.tools import dynahoi


def assert_same(before: Episode, after: Episode) -> None:
    """Compare all but images."""
    assert (after.meta, after.success, after.stage) == (before.meta, before.success, before.stage)
    for name, feature in FEATURES.items():
        one = getattr(before, name)
        other = getattr(after, name)
        assert (one is None) == (other is None), name
        if one is not None:
            np.testing.assert_array_equal(
                np.asarray(one, feature.dtype), np.asarray(other, feature.dtype), name
            )


@pytest.mark.parametrize("codec", CODECS)
def test_episodes_come_back_as_they_were_and_give_the_same_bytes_again(codec, tmp_path):
    episodes = [varied_episode(seed, 64, ("side",)) for seed in range(3)]
    for name in "ab":
        write_episodes(tmp_path / name, episodes, Encoding(codec))
    assert (
        hash_files(tmp_path / "a")
        == hash_files(tmp_path / "b")
        == Manifest.read(tmp_path / "a").files
    )
    for before, after in zip(episodes, read_episodes(tmp_path / "a"), strict=True):
        assert_same(before, after)
        assert list(after.images) == list(before.images) == ["ego", "side"]
        for view, images in before.images.items():
            error = np.abs(after.images[view].astype(int) - images.astype(int)).mean()
            assert error == 0 if codec == "images" else error < 6


def with_touch(seed: int) -> Episode:
    episode = varied_episode(seed, None)
    force = np.random.default_rng(seed).uniform(0, 9, (len(episode), 5)).astype(np.float32)
    return dataclasses.replace(episode, touch=force)


@pytest.mark.parametrize("make", [lambda seed: varied_episode(seed, None), with_touch])
def test_columns_that_some_recordings_lack_come_back_where_they_were(tmp_path, make):
    write_episodes(tmp_path / "d", [make(seed) for seed in range(2)])
    assert not (tmp_path / "d/videos").exists()
    for seed, after in enumerate(read_episodes(tmp_path / "d")):
        assert_same(make(seed), after)
        assert after.images == {}


@pytest.mark.parametrize(
    ("first", "second", "column"),
    [
        (with_touch(0), varied_episode(1, None), "observation.touch"),
        (varied_episode(0), varied_episode(1, 32, ("side",)), "observation.images.side"),
        (varied_episode(0), varied_episode(1, 16), "observation.images.ego"),
    ],
)
def test_an_episode_with_other_columns_is_refused_by_name(tmp_path, first, second, column):
    with pytest.raises(ValueError, match=re.escape(column)):
        write_episodes(tmp_path / "d", [first, second])
    assert not any(tmp_path.iterdir())


def test_files_roll_over_at_their_limits(tmp_path):
    layout = FileLimits(data_mb=0.005, video_mb=0.003, chunk_files=2)
    root = write(tmp_path / "d", range(8), limits=layout)
    store = Store(root)
    assert len(store.data.files) > 2
    assert {row["data/chunk_index"] for row in store.rows} > {0}
    assert len({store.video_path(row, CAMERA_KEY) for row in store.rows}) > 2
    for seed, episode in enumerate(read_episodes(root)):
        written = varied_episode(seed)
        np.testing.assert_array_equal(episode.action, written.action)
        assert np.abs(episode.images["ego"].astype(int) - written.images["ego"]).mean() < 6


def test_what_is_no_dataset_or_would_replace_one_is_refused_and_leaves_nothing(tmp_path, dataset):
    before = hash_files(dataset)
    new = tmp_path / "d"
    for error, attempt in (
        (ValueError, lambda: write_episodes(new, [varied_episode(1, 33)])),
        (ValueError, lambda: write_episodes(new, [])),
        (ValueError, lambda: copy_subset(dataset, new, [])),
        (ValueError, lambda: copy_subset(dataset, new, [0, 7])),
        (ValueError, lambda: merge([], new)),
        (IndexError, lambda: Store(dataset).row(6)),
        (FileNotFoundError, lambda: Store(tmp_path)),
        (FileExistsError, lambda: write_episodes(dataset, [varied_episode(0)])),
        (FileExistsError, lambda: copy_subset(dataset, tmp_path, [0])),
    ):
        with pytest.raises(error):
            attempt()
    assert not any(tmp_path.iterdir())
    assert hash_files(dataset) == before


@pytest.mark.parametrize("name", ["a[b]/d", "a*", "a?", "a::b"])
def test_a_path_that_lerobot_takes_for_a_pattern_is_refused_and_nothing_is_made(
    tmp_path, dataset, name
):
    root = tmp_path / name
    for attempt in (
        lambda: write_episodes(root, [varied_episode(0)]),
        lambda: merge([dataset], root),
        lambda: copy_subset(dataset, root, [0]),
        lambda: open_dataset(root),
    ):
        with pytest.raises(ValueError, match="LeRobot cannot open"):
            attempt()
    dynahoi("generate", "--root", root, "--episodes", "1", code=2)
    assert not root.exists()


@pytest.mark.parametrize("codec", CODECS)
def test_merging_gives_the_bytes_of_writing_at_once(tmp_path, codec):
    limits = FileLimits(data_mb=0.005, video_s=2.3)
    options = {"image_size": 32, "views": ("side",), "encoding": Encoding(codec), "limits": limits}
    parts = [
        write(tmp_path / "a", range(3), **options),
        write(tmp_path / "b", range(3, 5), **options),
    ]
    merge(parts, tmp_path / "merged", limits=limits)
    whole = write(tmp_path / "whole", range(5), **options)
    assert hash_files(tmp_path / "merged") == hash_files(whole)
    assert Manifest.read(tmp_path / "merged") == Manifest.read(whole)


def test_a_copy_of_some_episodes_gives_the_bytes_of_writing_them(tmp_path):
    root = write(tmp_path / "d", range(6), views=("side",))
    wanted = write(tmp_path / "w", [1, 2, 4], views=("side",))
    assert copy_subset(root, tmp_path / "kept", [4, 1, 2]).provenance["kept"] == [1, 2, 4]
    found = hash_files(tmp_path / "kept")
    held = hash_files(wanted)
    assert {name for name in held if found[name] != held[name]} == {"README.md"}


@pytest.mark.parametrize(
    ("other", "column"),
    [
        ({"subtasks": True}, "language_persistent"),
        ({"views": ("side",)}, "observation.images.side"),
    ],
)
def test_merge_refuses_datasets_of_other_options_and_names_the_column(tmp_path, other, column):
    plain = write(tmp_path / "a", range(1))
    unlike = write(tmp_path / "b", range(1), **other)
    for parts in ([plain, unlike], [unlike, plain]):
        with pytest.raises(
            ValueError, match=f"other features than {re.escape(str(parts[0]))} .{column}"
        ):
            merge(parts, tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_merge_refuses_versions_of_the_benchmark(tmp_path):
    old = tmp_path / "old"
    new = write(tmp_path / "new", range(1))
    write_episodes(old, [changed(varied_episode(1), {"benchmark": "v0"})])
    with pytest.raises(ValueError, match="'v0'"):
        merge([old, new], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_a_frame_column_has_a_row_per_frame_wherever_it_is_stored(dataset):
    episodes = list(read_episodes(dataset))
    lengths = [len(episode) for episode in episodes]

    def in_frames(name: str) -> np.ndarray:
        return np.concatenate([getattr(episode, name) for episode in episodes])

    def of_episodes(name: str) -> np.ndarray:
        return np.repeat([getattr(episode, name) for episode in episodes], lengths, axis=0)

    for key, values in {
        "action": in_frames("action"),
        "target.pose": in_frames("target_pose_h"),
        "localized": in_frames("localized")[:, None],
        "home_position": of_episodes("home_pos_w"),
        "intercept.time": of_episodes("intercept_s")[:, None],
    }.items():
        found = frame_column(dataset, key)
        np.testing.assert_array_equal(found, values.astype(found.dtype), key)
    for key in ("target.colour", "object_primitives", "attempt_success", CAMERA_KEY, "task"):
        with pytest.raises(ValueError, match=re.escape(key)):
            frame_column(dataset, key)


def test_an_episode_column_has_an_item_per_episode(dataset):
    episodes = list(read_episodes(dataset))
    for key, name in (
        ("target_path", "target_path_h"),
        ("target.pose", "target_pose_h"),
        ("open_joints", "open_joints"),
    ):
        for found, episode in zip(episode_column(dataset, key), episodes, strict=True):
            np.testing.assert_array_equal(found, getattr(episode, name))


def test_the_metadata_of_its_card_are_lerobots_and_more(dataset: Path):
    from lerobot.datasets.utils import create_lerobot_dataset_card

    theirs = create_lerobot_dataset_card(license="apache-2.0").data.to_dict()
    ours = yaml.safe_load((dataset / "README.md").read_text().split("---")[1])
    assert set(theirs["tags"]) <= set(ours["tags"])
    assert {name: ours[name] for name in theirs if name != "tags"} == {
        n: v for n, v in theirs.items() if n != "tags"
    }
    assert ours["size_categories"] == ["n<1K"]


def test_its_card_counts_and_describes_what_is_there(dataset: Path):
    manifest = Manifest.read(dataset)
    card = (dataset / "README.md").read_text()
    assert f"{manifest.episodes} episodes ({manifest.frames} frames" in card
    assert "{{" not in card.replace("{{DynaHOI}", "")
    for key in [*Store(dataset).features, *(feature.key for feature in privileged_features())]:
        assert f"| `{key}` |" in card
    drawing = (dataset / "assets/action.svg").read_text()
    assert all(f">{name}<" in drawing for name in COMMAND_NAMES), "every dimension has a panel"
