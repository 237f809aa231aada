"""The Dockerfile's instructions, carried out one by one in an empty environment, without Docker."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCKERFILE = ROOT / "envs" / "vla_eval" / "Dockerfile"
IMAGE_ROOT = "/workspace"
VALIDATE = """
import sys
from pathlib import Path
from vla_eval.cli.smoke import run_validate, smoke_test_from_path
print(run_validate([smoke_test_from_path(Path(sys.argv[1]))]).message)
"""
"""What ``vla-eval test --validate`` does, for one config."""


def instructions() -> list[tuple[str, str]]:
    """Return the keyword and the rest of every line that is no comment."""
    lines = [line for line in DOCKERFILE.read_text().splitlines() if line and not line.startswith("#")]
    return [(keyword, rest) for keyword, _, rest in (line.partition(" ") for line in lines)]


def carry_out(keyword: str, rest: str, workspace: Path, environment: dict[str, str]) -> None:
    """Do what COPY or RUN says in ``workspace``, installing with uv, which keeps downloads, as pip would."""
    if keyword == "COPY":
        *sources, target = rest.split()
        for source in (path for pattern in sources for path in ROOT.glob(pattern.rstrip("/"))):
            copy(source, workspace / target)
    elif keyword == "RUN":
        command = rest.replace("pip install --no-cache-dir", "uv pip install --quiet --no-sources")
        subprocess.run(command, shell=True, cwd=workspace, env=environment, check=True)


def copy(source: Path, target: Path) -> None:
    """Copy as Docker does: what is in a folder, and a file into the folder that ``target`` is."""
    target.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    else:
        shutil.copy(source, target)


@pytest.mark.slow
def test_the_instructions_lead_to_a_harness_that_has_the_benchmark(tmp_path: Path):
    workspace, environment = tmp_path / "workspace", tmp_path / "environment"
    version = dict(instructions())["FROM"].removeprefix("python:").removesuffix("-slim")
    subprocess.run(["uv", "venv", "--quiet", "--python", version, environment], check=True)
    here = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "PYTEST"))}
    here |= {"VIRTUAL_ENV": str(environment), "PATH": f"{environment / 'bin'}:{here['PATH']}", "MPLBACKEND": "Agg"}
    for keyword, rest in instructions():
        carry_out(keyword, rest, workspace, here)
    said = {keyword: json.loads(rest) for keyword, rest in instructions() if keyword in ("ENTRYPOINT", "CMD")}
    assert (environment / "bin" / said["ENTRYPOINT"][0]).is_file()
    assert said["CMD"][0] == "run"
    config = workspace / Path(said["CMD"][-1]).relative_to(IMAGE_ROOT)
    command = [environment / "bin" / "python", "-c", VALIDATE, config]
    said_of_config = subprocess.run(command, cwd=workspace, env=here, capture_output=True, text=True, check=True).stdout
    assert said_of_config.strip() == "1/1 configs valid"
