"""Blocks of code of the pages, executed with smaller numbers than people are told to type."""

from __future__ import annotations

import os
import sys
from importlib.metadata import entry_points
from pathlib import Path

from accelerate.state import AcceleratorState

from tests.docs.documents import ROOT, Block

SIZE = 32
FILES = ("recipes", "envs", "checkpoints")
"""Folders of the repository that commands name."""
VALUES = {
    "dynahoi generate": {"--episodes": 2, "--image-size": SIZE, "--workers": 1},
    "dynahoi evaluate": {"--episodes": 2},
    "dynahoi view": {},
    "lerobot-train": {"--steps": 2, "--batch_size": 2, "--env_eval_freq": 2, "--env.image_size": SIZE},
    "lerobot-eval": {"--eval.n_episodes": 1, "--eval.batch_size": 1, "--env.image_size": SIZE},
}
"""What replaces the values of these options, by command."""
ADDED = {
    "dynahoi evaluate": ["--episodes=2"],
    "lerobot-train": ["--num_workers=0", "--log_freq=1", "--eval.n_episodes=1", "--eval.batch_size=1"],
    "lerobot-eval": ["--env.task=lob"],
}
"""Options that make a command small, by command."""
ADDED_TO = {
    "--env.type=dynahoi": ["--env.task=lob"],
    "--policy.type=act": ["--policy.pretrained_backbone_weights=null"],
    "--resume=true": ["--steps=3"],
    "--recipe": ["--image-size=32"],
}
"""Further ones, by an option that a command has."""
TRAIN = "lerobot.scripts.lerobot_train"


def play(block: Block) -> None:
    """Execute a block in the current folder: save the file, run the program or every command."""
    if block.file:
        Path(block.file).write_text(block.body)
    elif block.language == "python":
        sys.path.insert(0, "")  # as `python FILE` in this folder would
        exec(compile(block.body, "block of code", "exec"), {"__name__": "__main__"})
    else:
        for words in block.commands:
            run(small(words))


def small(words: list[str]) -> list[str]:
    """Return a command that does the same in less time."""
    command = next((key for key in VALUES if _names(words, key)), "")
    kept = [word for group in _grouped(words) for word in _replaced(group, VALUES.get(command, {}))]
    added = ADDED.get(command, []) + [extra for key, more in ADDED_TO.items() if key in words for extra in more]
    given = {word.partition("=")[0] for word in words}
    return kept + [word for word in added if word.partition("=")[0] not in given or "--resume=true" in words]


def run(words: list[str]) -> None:
    """Run a command in this process, as its console script does.

    Raises:
        AssertionError: if it does not exit with 0.
    """
    AcceleratorState._reset_state(reset_partial_state=True)
    (script,) = entry_points(group="console_scripts", name=words[0])
    before, sys.argv = sys.argv, words
    try:
        code = script.load()()
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
    assert not code, f"{' '.join(words)}: exit code {code}"


def prepare(folder: Path) -> None:
    """Let the folders that commands name be found below ``folder``, and make it the current one."""
    for name in FILES:
        (folder / name).symlink_to(ROOT / name)
    os.chdir(folder)


def _names(words: list[str], command: str) -> bool:
    return words[: command.count(" ") + 1] == command.split() or (command == "lerobot-train" and TRAIN in words)


def _grouped(words: list[str]) -> list[list[str]]:
    """Options together with the value that follows them, everything else alone."""
    groups: list[list[str]] = []
    for word in words:
        follows = groups and groups[-1][0].startswith("--") and "=" not in groups[-1][0] and len(groups[-1]) == 1
        if follows and not word.startswith("-"):
            groups[-1].append(word)
        else:
            groups.append([word])
    return groups


def _replaced(group: list[str], values: dict[str, int]) -> list[str]:
    name = group[0].partition("=")[0]
    if name not in values:
        return group
    return [f"{name}={values[name]}"] if "=" in group[0] else [name, str(values[name])]
