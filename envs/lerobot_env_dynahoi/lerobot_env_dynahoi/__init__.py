"""The DynaHOI benchmark as a LeRobot environment: ``--env.type=dynahoi``.

LeRobot imports this package by its distribution name; importing it registers the config and the
gymnasium ids.
"""

from importlib.metadata import version

from dynahoi_lerobot.env import register_envs
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

__version__ = version("lerobot_env_dynahoi")

register_envs()

__all__ = ["DynahoiEnvConfig"]
