"""Datasets on disk, written once per run."""

from __future__ import annotations

from pathlib import Path

import pytest
from tracker_helpers import HAND_FEATURES, PUSH_FEATURES, write_dataset


@pytest.fixture(scope="session")
def hand_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "hand"
    write_dataset(root, HAND_FEATURES)
    return root


@pytest.fixture(scope="session")
def push_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "push"
    write_dataset(root, PUSH_FEATURES)
    return root
