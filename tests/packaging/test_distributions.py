"""The four distributions agree with each other, with their metadata and with what is tested."""

from __future__ import annotations

import importlib
import re
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PROJECTS = sorted(
    [ROOT / "pyproject.toml", *ROOT.glob("envs/*/pyproject.toml"), *ROOT.glob("policies/*/pyproject.toml")]
)
TYPED = ("dynahoi_lerobot", "lerobot_env_dynahoi")


def project(path: Path) -> dict[str, Any]:
    """Return the ``[project]`` table."""
    return tomllib.loads(path.read_text())["project"]


@pytest.mark.parametrize("name", TYPED)
def test_a_package_tells_its_version_and_that_it_is_typed(name: str) -> None:
    package = importlib.import_module(name)
    assert package.__version__ == version(name)
    assert package.__version__ in {project(path)["version"] for path in PROJECTS if project(path)["name"] == name}
    assert (Path(package.__file__).parent / "py.typed").is_file()


def test_all_distributions_want_the_same_pythons_and_every_one_is_tested() -> None:
    (wanted,) = {project(path)["requires-python"] for path in PROJECTS}
    first, end = (int(minor) for minor in re.fullmatch(r">=3\.(\d+),<3\.(\d+)", wanted).groups())
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    tested = workflow["jobs"]["fast"]["strategy"]["matrix"]["python"]
    assert tested == [f"3.{minor}" for minor in range(first, end)]


def test_distributions_bound_lerobot_alike() -> None:
    words = [
        word
        for path in PROJECTS
        for group in [project(path)["dependencies"], *project(path).get("optional-dependencies", {}).values()]
        for word in group
        if re.match(r"lerobot(\[|>|$)", word)
    ]
    assert len(words) >= 4
    assert len({re.sub(r"^lerobot(\[.*\])?", "", word) for word in words}) == 1, words
