"""Blocks of code of the pages, run as they are written but for their counts, and without a
network.
"""

import glob
import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from tests.docs.documents import ROOT, Block
from tests.tools import python, run

LINKED = ("recipes", "envs", "checkpoints", "policies", "benchmarks")
"""Folders of the repository that commands name."""
COUNTS = {
    "dynahoi generate --recipe": {"--episodes": "2", "--workers": "1"},
    "dynahoi generate": {"--episodes": "2"},
    "dynahoi evaluate": {"--episodes": "2", "--gifs": "1"},
    "dynahoi verify": {"--replay": "1"},
    "dynahoi filter": {"--drop": "0"},
    "lerobot-train": {
        "--steps": "2",
        "--batch_size": "2",
        "--env_eval_freq": "2",
        "--eval.n_episodes": "1",
        "--eval.batch_size": "1",
    },
    "lerobot-eval": {"--eval.n_episodes": "1", "--eval.batch_size": "1"},
}
"""What replaces the values of these options, where a command has them."""
FEWER = {
    "dynahoi quickstart": ["--tiny"],
    "dynahoi pretrain": ["--set=images=64", "--set=n_episodes=2"],
    "dynahoi evaluate": ["--episodes=2"],
    "lerobot-train": ["--steps=2", "--batch_size=2", "--num_workers=0", "--log_freq=1"],
    "lerobot-eval": ["--env.task=lob"],
}
"""What is added to commands that do not have it: all of a split are too many, and so are all kinds
of motion."""
FEWER_WITH = {
    "--env.type=dynahoi": ["--env.task=lob"],
    "--policy.type=act": [
        "--policy.dim_model=64",
        "--policy.n_heads=2",
        "--policy.dim_feedforward=64",
    ],
    "--resume=true": ["--steps=3"],
    "--config_path=recipes/train/vqbet.yaml": ["--policy.n_vqvae_training_steps=1"],
}
"""Likewise, to commands with these options."""
TRAINING = "lerobot.scripts.lerobot_train"
INSTALLERS = ("pip", "uv")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


@dataclass
class Player:
    """Plays blocks in the current folder.

    Attributes:
        placeholders: what stands for USER, NAME and URL.
        hub: environment variables that lead to a Hub; commands that name one of its repositories
            get them.
    """

    placeholders: dict[str, str] = field(default_factory=dict)
    hub: dict[str, str] = field(default_factory=dict)

    def play(self, block: Block) -> None:
        """Save the file, run the program in a process of its own, or run every command."""
        if block.file:
            Path(block.file).write_text(block.body)
        elif block.language == "python":
            python("-c", block.body)
        else:
            for words in block.commands:
                self.run(words)

    def run(self, words: list[str]) -> None:
        """Run a command with smaller counts."""
        if words[0] in INSTALLERS:
            check_installation(words)
            words = wrapped(words)
            if not words:
                return
        words = [name for word in small(words) for name in self._filled(word)]
        if any(re.search(rf"(^|=){self.placeholders.get('USER')}/", word) for word in words):
            run_elsewhere(words, self.hub)
        else:
            run(words)

    def _filled(self, word: str) -> list[str]:
        """Return the word with its placeholders replaced, or the files that a pattern stands
        for.
        """
        if "*" in word:
            return sorted(glob.glob(word))
        for name, value in self.placeholders.items():
            before, found, after = word.partition(name)
            if found and before[-1:] in ("", "=") and after[:1] in ("", "/"):
                return [before + value + after]
        return [word]


def small(words: list[str]) -> list[str]:
    """Return a command that does the same with fewer episodes and steps; of repeated options, the
    last count.
    """
    command = next((key for key in COUNTS | FEWER if _names(words, key)), "")
    given = {word.partition("=")[0] for word in words}
    fewer = [f"{name}={value}" for name, value in COUNTS.get(command, {}).items() if name in given]
    given -= {"--steps"} if "--resume=true" in words else set()
    added = FEWER.get(command, []) if not given & {"--replay", "--dry-run"} else []
    added = added + [extra for key, more in FEWER_WITH.items() if key in words for extra in more]
    return words + fewer + [word for word in added if word.partition("=")[0] not in given]


def run_elsewhere(words: list[str], environment: dict[str, str]) -> None:
    """Run a command in a process of its own, because the Hub's client reads its settings once."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HF_")}
    command = [Path(sys.executable).with_name(words[0]), *words[1:]]
    done = subprocess.run(
        command, env=kept | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr[-2000:]}"


def check_installation(words: list[str]) -> None:
    """Compare what a command installs with what this repository offers, because nothing is
    installed in a test.
    """
    groups = {after for word, after in pairwise(words) if word == "--group"}
    assert groups <= set(PROJECT["dependency-groups"]), words
    _, *installed = words[words.index("install") :] if "install" in words else words[:1]
    for word in (word for word in installed if not word.startswith("-")):
        folder, _, extras = word.removesuffix("]").partition("[")
        if shutil.which(folder):
            continue  # a program that is installed here
        project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        offered = {"", *project.get("optional-dependencies", ())}
        assert set(extras.split(",")) <= offered, word


def wrapped(words: list[str]) -> list[str]:
    """Return the command that ``uv run`` runs, nothing for other commands; this suite stands for
    ``pytest``.
    """
    if words[:2] != ["uv", "run"]:
        return []
    command = words[4:] if words[2] == "--group" else words[2:]
    return [] if command == ["pytest"] else command


def prepare(folder: Path) -> None:
    """Let the folders that commands name be found below ``folder``, and make it the current one."""
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
    os.chdir(folder)


def _names(words: list[str], command: str) -> bool:
    return words[: command.count(" ") + 1] == command.split() or (
        command == "lerobot-train" and TRAINING in words
    )
