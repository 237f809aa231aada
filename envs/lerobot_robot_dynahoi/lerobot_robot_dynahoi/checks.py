"""What is wrong with LeRobot's command line, in one sentence, before LeRobot reads it."""

import draccus

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.lerobot_internals import (
    command_name,
    given,
    given_type,
    given_words,
    mistakes_in_a_sentence,
)
from lerobot_robot_dynahoi.config_dynahoi import DynahoiRobotConfig


def check_command_line() -> None:
    """End the process if the command line asks for this robot with options that it does not have,
    or at another rate than that of its world, which LeRobot's default is.
    """
    if given_type("robot") != "dynahoi":
        return
    with mistakes_in_a_sentence():
        config = draccus.parse(DynahoiRobotConfig, args=given_words("robot"))
        if given("config_path") is not None:
            return  # which may say at what rate
        command = command_name()
        if command in ("lerobot-record", "lerobot-rollout") and given("dataset.repo_id"):
            _check_rate("dataset.fps", "frames are recorded at the rate of the world")
        if command == "lerobot-rollout" and config.realtime:
            _check_rate("fps", "policies learned at this rate")


def _check_rate(option: str, reason: str) -> None:
    rate = given(option)
    if rate is None or float(rate) != CONTROL_HZ:
        told = "not given, and LeRobot's default is 30" if rate is None else rate
        raise ValueError(f"{option} must be {CONTROL_HZ}, because {reason}, but is {told}")
