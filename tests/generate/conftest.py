"""A policy that has learned nothing, for recordings in which it moves the hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.checkpoints import tiny_obact


@pytest.fixture(scope="session")
def actor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a tiny ObAct for images of 32 pixels."""
    return tiny_obact(tmp_path_factory.mktemp("actor") / "checkpoint")
