import shutil
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import frame_column, open_dataset, write_episodes
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.verify.command import verify
from dynahoi_lerobot.verify.filter import find_outliers
from tests.dataset.episodes import changed, varied_episode

SENTENCE = "episode 7: action.thumb_tip.pos reaches 2.200, outside -0.500 to 1.500 in 1 frame"


@pytest.fixture(scope="module")
def with_outlier(tmp_path_factory) -> Path:
    """Twelve episodes, of which one reaches a finger further than any other, for a single frame."""
    episodes = [varied_episode(seed, 16) for seed in range(12)]
    episodes[7] = changed("action", (10, 5), 2.2)(episodes[7])
    root = tmp_path_factory.mktemp("outlier") / "d"
    write_episodes(root, episodes)
    return root


def run(*words: object) -> int:
    return main(["filter", *map(str, words)])


def test_outliers_are_named(with_outlier):
    assert find_outliers(with_outlier, margin=0.5) == {7: SENTENCE}
    assert find_outliers(with_outlier, margin=2.0) == {}
    assert find_outliers(with_outlier, margin=0.5, column="observation.state") == {}


def write_with_nan(root: Path, episodes: int) -> Path:
    """Episodes of which the second has one command that is not a number."""
    first, second, *others = (varied_episode(seed, None) for seed in range(episodes))
    write_episodes(root, [first, changed("action", (4, 2), np.nan)(second), *others])
    return root


def test_nan_is_an_outlier(tmp_path):
    ((episode, sentence),) = find_outliers(write_with_nan(tmp_path / "d", episodes=6)).items()
    assert episode == 1
    assert "action.palm_z.pos reaches nan" in sentence


def test_a_column_without_a_robust_range_is_refused(tmp_path, capsys):
    assert run(write_with_nan(tmp_path / "d", episodes=2), "--dry-run") == 2
    assert "action is often not finite, so it has no robust range" in capsys.readouterr().err


def test_a_dataset_of_others_is_refused(with_outlier, tmp_path, capsys):
    stock = shutil.copytree(with_outlier, tmp_path / "stock")
    (stock / "meta/manifest.json").unlink()
    assert run(stock, "--out", tmp_path / "new") == 2
    assert "stock was not written by this project: meta/manifest.json is missing" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_all_others_are_copied_and_lerobot_reads_them(with_outlier, tmp_path, capsys):
    before = hash_files(with_outlier)
    assert run(with_outlier, "--out", tmp_path / "new", "--margin", 0.5) == 0
    printed = capsys.readouterr().out
    assert SENTENCE in printed
    assert f"1 of 12 episodes left out; the others are in {tmp_path / 'new'}" in printed
    kept = [seed for seed in range(12) if seed != 7]
    opened = open_dataset(tmp_path / "new")
    assert opened.meta.episodes["seed"] == kept
    first_of_eighth = sum(20 + seed % 7 for seed in kept[:7])
    np.testing.assert_array_equal(opened[first_of_eighth + 3]["action"], varied_episode(8).action[3])
    image = np.moveaxis(opened[first_of_eighth + 3]["observation.images.ego"].numpy() * 255, 0, -1)
    assert np.abs(image - varied_episode(8, 16).images["ego"][3]).mean() < 6
    assert [f for f in verify(tmp_path / "new") if f.check != "verdicts"] == []
    assert Manifest.read(tmp_path / "new").provenance["kept"] == kept
    assert hash_files(with_outlier) == before


def test_a_dry_run_writes_nothing(with_outlier, tmp_path, capsys):
    assert run(with_outlier, "--margin", 0.5, "--dry-run") == 0
    printed = capsys.readouterr().out
    assert SENTENCE in printed
    assert "dry run, nothing was written" in printed
    assert run(with_outlier, "--dry-run", "--out", tmp_path / "new") == 0
    assert not any(tmp_path.iterdir())


def test_named_episodes_are_left_out_and_nothing_else_is_lost(with_outlier, tmp_path):
    assert run(with_outlier, "--out", tmp_path / "new", "--drop", "0,3") == 0
    assert [row["seed"] for row in Store(tmp_path / "new").rows] == [1, 2, *range(4, 12)]
    assert frame_column(tmp_path / "new", "target.pose").shape[1] == 7
