"""Commands play on a machine that gives the user no home folder to write to, or no name."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.checkpoints import SHIPPED

NOBODY = 12345
"""A user whom no passwd file names."""
CAPABILITY = "+dac_read_search"
"""Lets that user read this interpreter, wherever it lies."""
USED = ("XDG_CACHE_HOME", "WARP_CACHE_PATH", "HF_HOME", "MPLCONFIGDIR", "HF_DATASETS_CACHE")
NAMES = ("USER", "LOGNAME", "LNAME", "USERNAME")


def run(words: list[str], home: str, folder: Path, *before: str) -> str:
    """Run a command with a home, caches in no other place, and temporary files in ``folder``;
    return what it writes to standard error.
    """
    environment = {name: value for name, value in os.environ.items() if name not in (*USED, *NAMES)}
    environment |= {"HOME": home, "TMPDIR": str(folder)}
    command = [*before, sys.executable, *words]
    done = subprocess.run(
        command, env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    tmp_path.chmod(0o777)
    return tmp_path


def told(said: str) -> list[str]:
    return [line for line in said.splitlines() if "cannot be written; caches go to" in line]


VIEW = ["-m", "dynahoi_lerobot.cli.main", "view", "--motion", "lob", "--image-size", "16"]
GYM = "import gymnasium as gym; gym.make('dynahoi_lerobot.env:dynahoi/all-v0', image_size=16)"


@pytest.mark.parametrize("words", [[*VIEW, "--out", "x.gif"], ["-c", f"{GYM}.reset(seed=0)"]])
def test_what_renders_does_without_a_home_and_says_so_once(words: list[str], folder: Path) -> None:
    (line,) = told(run(words, "/dev/null/home", folder))
    assert str(folder) in line
    assert [*folder.glob("dynahoi-caches-*/warp")]


def test_nothing_is_said_or_moved_where_the_home_can_be_written(folder: Path) -> None:
    said = run([*VIEW, "--out", "x.gif"], str(folder), folder)
    assert not told(said)
    assert (folder / ".cache/warp").is_dir()


def test_a_cache_that_somebody_else_may_have_made_is_not_used(folder: Path) -> None:
    theirs = folder / f"dynahoi-caches-{os.getuid()}"
    theirs.mkdir()
    theirs.chmod(0o777)
    told(run([*VIEW, "--out", "x.gif"], "/dev/null/home", folder))
    assert not [*theirs.iterdir()]
    assert [*folder.glob("dynahoi-caches-?*/warp")]


@pytest.mark.skipif(os.getuid() != 0 or not shutil.which("setpriv"), reason="needs root")
def test_a_policy_plays_for_a_user_without_a_name(folder: Path) -> None:
    user = ["setpriv", f"--reuid={NOBODY}", "--clear-groups"]
    user += [f"--inh-caps={CAPABILITY}", f"--ambient-caps={CAPABILITY}"]
    words = ["-m", "dynahoi_lerobot.cli.main", "evaluate", "--policy", str(SHIPPED)]
    assert told(run([*words, "--episodes", "1"], "/nonexistent", folder, *user))
