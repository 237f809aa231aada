"""A policy that has learned nothing, for recordings in which it moves the hand; a dataset made undisturbed."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.generate.pipeline import generate
from tests.checkpoints import tiny_obact
from tests.generate.recorder import PLAN, record


@pytest.fixture(scope="session")
def actor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a tiny ObAct for images of 32 pixels."""
    return tiny_obact(tmp_path_factory.mktemp("actor") / "checkpoint")


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the dataset of ``PLAN`` as one process makes them."""
    root = tmp_path_factory.mktemp("undisturbed") / "d"
    generate(PLAN, root, record=record)
    return hash_files(root)
