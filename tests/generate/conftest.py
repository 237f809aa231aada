"""A dataset that is made undisturbed."""

from pathlib import Path

import pytest

from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.generate.pipeline import generate
from tests.generate.recorder import PLAN, record


@pytest.fixture(scope="session")
def undisturbed(once) -> dict[str, str]:
    """The files of the dataset of ``PLAN`` as one process makes them."""

    def make(root: Path) -> dict[str, str]:
        generate(PLAN, root, record=record)
        return hash_files(root)

    return once("undisturbed", make)
