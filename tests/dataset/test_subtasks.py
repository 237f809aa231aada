"""Subtasks in LeRobot's language column: written by ``generate --subtasks``, read and rendered by LeRobot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.language import ARROW, HOLD, INFO, LANGUAGE, REACH, WATCH, language_column, subtask_rows
from tests.dataset.lerobot_api import open_dataset
from tests.verify.forgery import changed_column


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    words = ["--root", str(root), "--episodes", "2", "--image-size", "0", "--motions", "constant,lob", "--subtasks"]
    assert main(["generate", *words]) == 0
    return root


def test_a_target_that_is_never_localised_is_never_to_be_held() -> None:
    rows = subtask_rows(np.array([False, False, True, True]), np.zeros(4, bool))
    assert [(row["content"], row["timestamp"]) for row in rows] == [(WATCH, 0.0), (REACH, pytest.approx(0.1))]
    assert [row["content"] for row in subtask_rows(np.ones(3, bool), np.array([False, True, True]))] == [REACH, HOLD]


def test_lerobot_finds_the_subtask_of_every_frame(root: Path) -> None:
    from lerobot.configs.recipe import MessageTurn, TrainingRecipe
    from lerobot.datasets.language_render import active_at, render_sample
    from lerobot.utils.collate import lerobot_collate_fn

    dataset = open_dataset(root, delta_timestamps={"action": [0.0, 0.05]})
    assert dataset.meta.has_language_columns
    (first, _) = read_episodes(root)
    samples = [dataset[i] for i in range(len(first))]
    found = [active_at(float(s["timestamp"]), persistent=s[LANGUAGE], style="subtask")["content"] for s in samples]
    wanted = [
        HOLD if held else REACH if acts else WATCH for (_, acts), held in zip(first.phase, first.localized, strict=True)
    ]
    assert found == wanted
    assert set(found) == {WATCH, REACH, HOLD}
    assert lerobot_collate_fn(samples[:2])["action"].shape == (2, 2, 18)
    turns = [
        MessageTurn(role="user", content="${task}", stream="high_level"),
        MessageTurn(role="assistant", content="${subtask}", stream="high_level", target=True),
    ]
    sample, recipe = samples[-1], TrainingRecipe(messages=turns)
    rendered = render_sample(
        recipe=recipe, persistent=sample[LANGUAGE], events=[], t=float(sample["timestamp"]), sample_idx=0,
        task=sample["task"],
    )  # fmt: skip
    assert [message["content"] for message in rendered["messages"]] == [first.meta.task, HOLD]


def test_the_column_is_lerobots(root: Path) -> None:
    from datasets import Features, load_dataset
    from lerobot.datasets.language import (
        LANGUAGE_PERSISTENT,
        PERSISTENT_ROW_FIELDS,
        column_for_style,
        language_feature_info,
    )

    assert LANGUAGE == LANGUAGE_PERSISTENT == column_for_style("subtask")
    assert tuple(field.name for field in ARROW.value_type) == PERSISTENT_ROW_FIELDS
    told = language_feature_info()[LANGUAGE]
    assert {**told, "shape": list(told["shape"])} == INFO
    (path,) = root.glob("data/*/*.parquet")
    noted = Features.from_arrow_schema(pq.read_schema(path))[LANGUAGE].feature
    assert list(noted) == list(PERSISTENT_ROW_FIELDS)
    streamed = next(iter(load_dataset(str(root), data_files="data/*/*.parquet", split="train", streaming=True)))
    assert [row["content"] for row in streamed[LANGUAGE]] == [WATCH, REACH, HOLD]


def test_lerobot_edits_it(root: Path, tmp_path: Path) -> None:
    from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets

    whole = open_dataset(root)
    rest = delete_episodes(whole, [0], output_dir=tmp_path / "rest", repo_id="local/rest")
    assert rest[0][LANGUAGE] == whole[int(whole.meta.episodes[1]["dataset_from_index"])][LANGUAGE]
    merged = merge_datasets([whole, rest], "local/merged", tmp_path / "merged")
    assert merged[len(merged) - 1][LANGUAGE] == whole[len(whole) - 1][LANGUAGE]


def test_verify_derives_them_again(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(root), "--replay", "1"]) == 0

    def late(column: pa.ChunkedArray) -> pa.Array:
        return pa.array(
            [[{**row, "timestamp": row["timestamp"] + 0.05} for row in rows] for rows in column.to_pylist()], ARROW
        )

    with changed_column(root, LANGUAGE, late):
        assert main(["verify", str(root)]) == 1
    assert f"subtasks: episode 0, frame 0: {LANGUAGE} is" in capsys.readouterr().out
    assert language_column([], 2).to_pylist() == [[], []]
