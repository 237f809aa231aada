"""What is wrong with LeRobot's command line, in one sentence, before LeRobot reads it."""

import os
from pathlib import Path

import draccus

from dynahoi_lerobot.core.lerobot_internals import (
    given,
    given_type,
    given_words,
    mistakes_in_a_sentence,
)
from dynahoi_lerobot.evaluate.checkpoint_files import CONFIG, described_folder, hint_at_checkpoint
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig
from lerobot_env_dynahoi.task_env import refuse_results

DESCRIBED = ("features", "features_map")
"""Fields of every environment's config that ours fills in by itself."""


def check_command_line() -> None:
    """End the process if the command line asks for this environment with options that it does not
    have or heed, or for a policy that is not there.
    """
    if given_type("env") != "dynahoi":
        return
    with mistakes_in_a_sentence():
        _check_policy(given("policy.path"))
        for name in DESCRIBED:
            if given(f"env.{name}") is not None:
                raise ValueError(
                    f"env.{name} cannot be set: it follows from env.views, env.image_size and the "
                    f"other rules"
                )
        config = draccus.parse(DynahoiEnvConfig, args=given_words("env"))
        if config.results_dir is not None:
            refuse_results(Path(config.results_dir))


def _check_policy(path: str | None) -> None:
    """Refuse a path that is neither a checkpoint's folder nor the name of a repository."""
    if path is None or (path.count("/") == 1 and not os.path.isdir(path)):
        return
    folder = described_folder(path)
    if not (folder / CONFIG).exists():
        raise ValueError(f"{folder} holds no policy (no {CONFIG}){hint_at_checkpoint(folder)}")
