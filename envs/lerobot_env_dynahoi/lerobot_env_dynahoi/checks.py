"""What is wrong with LeRobot's command line, in one sentence, before LeRobot reads it.

LeRobot would print a traceback, and only after it has loaded everything else.
"""

import os
import sys
from pathlib import Path

import draccus
from draccus.utils import DraccusException
from lerobot.configs import parser

from dynahoi_lerobot.evaluate.checkpoint import CONFIG, described_folder, hint_at_checkpoint
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

BAD_INPUT = 2
"""Exit code."""


def check_command_line() -> None:
    """End the process if the command line asks for this environment with options that it does not
    have, or for a policy that is not there.
    """
    if parser.get_type_arg("env") != "dynahoi":
        return
    try:
        _check_policy(parser.parse_arg("policy.path"))
        draccus.parse(DynahoiEnvConfig, args=parser.get_cli_overrides("env") or [])
    except (ValueError, DraccusException) as error:
        sentence = " ".join(str(error.__cause__ or error).split())
        print(f"{Path(sys.argv[0]).stem}: {sentence}", file=sys.stderr)
        sys.exit(BAD_INPUT)


def _check_policy(path: str | None) -> None:
    """Refuse a path that is neither a checkpoint's folder nor the name of a repository."""
    if path is None or (path.count("/") == 1 and not os.path.isdir(path)):
        return
    folder = described_folder(path)
    if not (folder / CONFIG).exists():
        raise ValueError(f"{folder} holds no policy (no {CONFIG}){hint_at_checkpoint(folder)}")
