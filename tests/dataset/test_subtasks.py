"""Subtasks in LeRobot's language column: written by ``generate --subtasks``, read and rendered by LeRobot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.columns import LANGUAGE, SUBTASKS, subtask_rows
from dynahoi_lerobot.dataset.store import Store
from tests.dataset.lerobot_api import open_dataset

WATCH, REACH, HOLD = SUBTASKS


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
    (path,) = root.glob("data/*/*.parquet")
    held = pq.read_schema(path).field(LANGUAGE).type.value_type
    assert tuple(field.name for field in held) == PERSISTENT_ROW_FIELDS
    told = language_feature_info()[LANGUAGE]
    assert {**told, "shape": list(told["shape"])} == Store(root).features[LANGUAGE]
    noted = Features.from_arrow_schema(pq.read_schema(path))[LANGUAGE].feature
    assert list(noted) == list(PERSISTENT_ROW_FIELDS)
    streamed = next(iter(load_dataset(str(root), data_files="data/*/*.parquet", split="train", streaming=True)))
    assert [row["content"] for row in streamed[LANGUAGE]] == [WATCH, REACH, HOLD]
