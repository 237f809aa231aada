"""The DynaHOI benchmark as a LeRobot environment: ``--env.type=dynahoi``.

LeRobot imports this package by its distribution name; importing it registers the config and the
gymnasium ids.
"""

from importlib.metadata import version

import dynahoi_lerobot.env  # noqa: F401 - registers the ids
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

__version__ = version("lerobot_env_dynahoi")

__all__ = ["DynahoiEnvConfig"]
