"""``dynahoi filter`` copies all episodes but outliers and those it is told to leave out."""

import shutil
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from dynahoi_lerobot.dataset import open_dataset, write_episodes
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.verify.command import verify
from dynahoi_lerobot.verify.filter import find_outliers
from tests.dataset.episodes import changed, varied_episode
from tests.tools import dynahoi, generated
from tests.verify.test_forgeries import DATA, ROWS, TRUTH, Forgery, column, table

SENTENCE = "episode 7: action.thumb_tip.pos reaches 2.200, outside -0.500 to 1.500 in 1 frame"


@pytest.fixture(scope="module")
def with_outlier(tmp_path_factory) -> Path:
    """Twelve episodes, of which one reaches a finger further than any other, for a single frame."""
    episodes = [varied_episode(seed, 16) for seed in range(12)]
    episodes[7] = changed("action", (10, 5), 2.2)(episodes[7])
    root = tmp_path_factory.mktemp("outlier") / "d"
    write_episodes(root, episodes)
    return root


def test_outliers_are_named(with_outlier):
    assert find_outliers(with_outlier, margin=0.5) == {7: SENTENCE}
    assert find_outliers(with_outlier, margin=2.0) == {}
    assert find_outliers(with_outlier, margin=0.5, column="observation.state") == {}


def test_nan_is_an_outlier_but_a_column_that_is_often_nan_has_no_range(tmp_path):
    first, second, *others = (varied_episode(seed, None) for seed in range(6))
    second = changed("action", (4, 2), np.nan)(second)
    write_episodes(tmp_path / "many", [first, second, *others])
    ((episode, sentence),) = find_outliers(tmp_path / "many").items()
    assert episode == 1
    assert "action.palm_z.pos reaches nan" in sentence
    few = tmp_path / "a few"
    write_episodes(few, [first, second])
    said = dynahoi("filter", few, "--dry-run", code=2).err
    assert (
        f"action is often not finite, so it has no robust range; see `dynahoi verify '{few}'`"
        in said
    )


def test_all_others_are_copied_and_lerobot_reads_them(with_outlier, tmp_path):
    before = hash_files(with_outlier)
    words = ["filter", with_outlier, "--out", tmp_path / "new", "--margin", 0.5]
    assert SENTENCE in dynahoi(*words).out
    kept = [seed for seed in range(12) if seed != 7]
    opened = open_dataset(tmp_path / "new")
    assert opened.meta.episodes["seed"] == kept
    first_of_eighth = sum(20 + seed % 7 for seed in kept[:7])
    np.testing.assert_array_equal(
        opened[first_of_eighth + 3]["action"], varied_episode(8).action[3]
    )
    image = np.moveaxis(opened[first_of_eighth + 3]["observation.images.ego"].numpy() * 255, 0, -1)
    assert np.abs(image - varied_episode(8, 16).images["ego"][3]).mean() < 6
    assert [f for f in verify(tmp_path / "new") if f.check != "verdicts"] == []
    assert Manifest.read(tmp_path / "new").provenance["kept"] == kept
    assert hash_files(with_outlier) == before


def test_a_dry_run_names_them_and_writes_nothing(with_outlier, tmp_path):
    words = ["filter", with_outlier, "--margin", 0.5, "--dry-run", "--out", tmp_path / "new"]
    assert SENTENCE in dynahoi(*words).out
    assert not any(tmp_path.iterdir())


def test_named_episodes_are_left_out(with_outlier, tmp_path):
    dynahoi("filter", with_outlier, "--out", tmp_path / "new", "--drop", "0,3")
    assert [row["seed"] for row in Store(tmp_path / "new").rows] == [1, 2, *range(4, 12)]


def test_a_copy_of_a_copy_passes_verify(tmp_path):
    words = ("--episodes", "4", "--image-size", "0", "--motions", "constant")
    made = generated(tmp_path / "made", *words)
    dynahoi("filter", made, "--out", tmp_path / "once", "--drop", "0")
    dynahoi("filter", tmp_path / "once", "--out", tmp_path / "twice", "--drop", "1")
    assert [row["seed"] for row in Store(tmp_path / "twice").rows] == [1, 3]
    assert "2 episodes, no findings" in dynahoi("verify", tmp_path / "twice", "--replay", 0).out


def retyped(path: str, key: str, values: list) -> Forgery:
    """Return a function that fills a column of a table with values of any type, over and over."""

    def change(found: pa.Table) -> pa.Table:
        column = pa.array(islice(cycle(values), len(found)))
        return found.set_column(found.schema.get_field_index(key), key, column)

    return table(path, change)


DAMAGES: list[tuple[Forgery, str]] = [
    (lambda root: (root / "meta/manifest.json").unlink(), "meta/manifest.json is missing"),
    (lambda root: shutil.rmtree(root / "data"), "there is no file in data"),
    (column(DATA, "index", lambda numbers: numbers[::-1]), "holds its frames in another order"),
    (retyped(ROWS, "tasks", [0.5]), "its column tasks is of type double; it must be list<"),
    (retyped(ROWS, "benchmark", [None]), "benchmark must be a valid string, got None"),
    (retyped(TRUTH, "frame_index", [0]), "privileged tables of other episodes"),
    (retyped(DATA, "action", [[0.0] * 17, [0.0] * 18]), "its column action is of"),
]


@pytest.mark.parametrize(("damage", "sentence"), DAMAGES)
def test_the_damaged_file_is_named(damage: Forgery, sentence: str, dataset: Path, tmp_path: Path):
    broken = shutil.copytree(dataset, tmp_path / "broken")
    damage(broken)
    said = dynahoi("filter", broken, "--out", tmp_path / "out", code=2).err
    assert sentence in said
    assert str(broken) in said
    assert said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["broken"]
