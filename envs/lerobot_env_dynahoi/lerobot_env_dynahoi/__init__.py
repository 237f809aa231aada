"""The DynaHOI benchmark as a LeRobot environment: ``--env.type=dynahoi``.

LeRobot imports this package by its distribution name; importing it registers the config and the
gymnasium ids, and checks the command line.
"""

from importlib.metadata import version

import dynahoi_lerobot.env  # noqa: F401 - registers the ids
from lerobot_env_dynahoi.checks import check_command_line
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

__version__ = version("lerobot_env_dynahoi")

check_command_line()

__all__ = ["DynahoiEnvConfig"]
