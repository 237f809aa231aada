"""A dataset that is made undisturbed."""

import pytest

from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.generate.pipeline import generate
from tests.generate.recorder import PLAN, record


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the dataset of ``PLAN`` as one process makes them."""
    root = tmp_path_factory.mktemp("undisturbed") / "d"
    generate(PLAN, root, record=record)
    return hash_files(root)
