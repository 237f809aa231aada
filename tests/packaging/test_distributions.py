"""The distributions agree with each other, with their metadata and with what is tested."""

import re
import shutil
import subprocess
import tomllib
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
PROJECTS = sorted(
    [
        ROOT / "pyproject.toml",
        *ROOT.glob("envs/*/pyproject.toml"),
        *ROOT.glob("policies/*/pyproject.toml"),
    ]
)
CORE = "dynahoi_lerobot"


def project(path: Path) -> dict[str, Any]:
    """Return the ``[project]`` table."""
    return tomllib.loads(path.read_text())["project"]


def test_the_constraints_are_the_versions_that_are_tested_here() -> None:
    words = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["uv"][
        "constraint-dependencies"
    ]
    pinned = dict(word.split("==") for word in words)
    installed = {
        re.sub(r"[-_.]+", "-", found.name.lower()): found.version for found in distributions()
    }
    assert {"lerobot", "mujoco", "numpy", "torch"} <= set(pinned)
    changed = {name: found for name, found in installed.items() if pinned.get(name, found) != found}
    assert not changed, "run .ci/pin if these are to be the tested ones"


def test_distributions_bound_lerobot_alike() -> None:
    words = [
        word
        for path in PROJECTS
        for group in [
            project(path)["dependencies"],
            *project(path).get("optional-dependencies", {}).values(),
        ]
        for word in group
        if re.match(r"lerobot(\[|>|$)", word)
    ]
    assert len(words) >= 4
    assert len({re.sub(r"^lerobot(\[.*\])?", "", word) for word in words}) == 1, words


def versions(root: Path) -> set[str]:
    """Return the versions of all distributions below ``root``, and those of the core that they ask
    for.
    """
    tables = [project(root / path.relative_to(ROOT)) for path in PROJECTS]
    pinned = [word for table in tables for word in table["dependencies"] if word.startswith(CORE)]
    assert pinned
    return {table["version"] for table in tables} | {word.split("==")[1] for word in pinned}


def test_versions_are_in_step() -> None:
    assert len(versions(ROOT)) == 1


def test_one_command_sets_all_versions(tmp_path: Path) -> None:
    for path in (*PROJECTS, ROOT / ".ci" / "version"):
        copy = tmp_path / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    done = subprocess.run(
        [tmp_path / ".ci" / "version", "9.8.7rc1"], capture_output=True, text=True, check=True
    )
    assert len(done.stdout.splitlines()) == len(PROJECTS)
    assert versions(tmp_path) == {"9.8.7rc1"}
    assert {project(path)["requires-python"] for path in tmp_path.rglob("*.toml")} == {
        ">=3.12,<3.14"
    }

    refused = subprocess.run(
        [tmp_path / ".ci" / "version", "9.8"], capture_output=True, text=True, check=False
    )
    assert refused.returncode == 2
    assert refused.stderr == "name a version such as 0.2.0 or 0.2.0rc1, got '9.8'\n"
    assert versions(tmp_path) == {"9.8.7rc1"}
