"""Blocks of code of the pages, run as they are written but for their counts, and without a
network.
"""

import glob
import os
import re
import shlex
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
TINY_ACT = "--policy.dim_model=64 --policy.n_heads=2 --policy.dim_feedforward=64"
SMALLER = {
    r"^dynahoi quickstart": "--tiny",
    r"^dynahoi generate": "--episodes=2",
    r"^dynahoi evaluate (?!--replay)": "--episodes=2",
    r"^dynahoi pretrain": "--set=images=64 --set=n_episodes=2",
    r"^dynahoi filter.* --drop": "--drop=0",
    r"^dynahoi verify.* --replay": "--replay=1",
    r"^dynahoi .* --gifs": "--gifs=1",
    r" --recipe .* --workers": "--workers=1",
    r"lerobot[-.\w]*train": "--steps=2 --batch_size=2 --num_workers=0 --log_freq=1",
    r" --resume=true": "--steps=3",
    r" --policy.type=act": TINY_ACT,
    r" --config_path=recipes/train/vqbet": "--policy.n_vqvae_training_steps=1",
    r" --env_eval_freq": "--env_eval_freq=2",
    r" --env.type=dynahoi": "--env.task=lob",
    r" --eval.n_episodes": "--eval.n_episodes=1 --eval.batch_size=1",
}
"""What is added to commands with these words, so that they do the same with fewer episodes and
steps; of repeated options, the last count."""
WRITTEN = r"--(?:out|root|csv|latex|output_dir|new_root|env\.results_dir)[= ](\S+)"
"""The files and folders that a command leaves."""
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
        """Run a command with smaller counts; installations are checked, not run."""
        if words[:2] == ["uv", "run"]:
            words = words[4:] if words[2] == "--group" else words[2:]
        if words[0] in ("pip", "uv"):
            check_installation(words)
            return
        if words == ["pytest"]:  # this suite
            return
        words = [name for word in smaller(words) for name in self._filled(word)]
        if any(re.search(rf"(^|=){self.placeholders.get('USER')}/", word) for word in words):
            run_elsewhere(words, self.hub)
        else:
            run(words)
        for path in re.findall(WRITTEN, " ".join(words)):
            assert Path(path).exists() == ("--dry-run" not in words), words

    def _filled(self, word: str) -> list[str]:
        """Return the word with its placeholders replaced, or the files that a pattern stands
        for.
        """
        if "*" in word:
            return sorted(glob.glob(word))
        for name, value in self.placeholders.items():
            word = re.sub(rf"(^|=){name}(?=/|$)", rf"\g<1>{value}", word)
        return [word]


def smaller(words: list[str]) -> list[str]:
    command = " ".join(words)
    added = [more for pattern, more in SMALLER.items() if re.search(pattern, command)]
    return words + shlex.split(" ".join(added))


def run_elsewhere(words: list[str], environment: dict[str, str]) -> None:
    """Run a command in a process of its own, because the Hub's client reads its settings once."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HF_")}
    command = [Path(sys.executable).with_name(words[0]), *words[1:]]
    done = subprocess.run(
        command, env=kept | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr[-2000:]}"


def check_installation(words: list[str]) -> None:
    """Compare the groups, folders and extras that a command installs with the repository's."""
    groups = {after for word, after in pairwise(words) if word == "--group"}
    assert groups <= set(PROJECT["dependency-groups"]), words
    for word in words[words.index("install") + 1 :] if "install" in words else ():
        folder, _, extras = word.removesuffix("]").partition("[")
        if word.startswith("-") or shutil.which(folder):  # a program that is installed here
            continue
        project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        assert set(extras.split(",")) <= {"", *project.get("optional-dependencies", ())}, word


def link_folders(folder: Path) -> None:
    """Let the folders that commands name be found below ``folder``."""
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
