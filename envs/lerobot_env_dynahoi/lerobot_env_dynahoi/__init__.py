"""The DynaHOI benchmark as a LeRobot environment: ``--env.type=dynahoi``.

LeRobot imports this package by its distribution name; importing it registers the config and the gymnasium ids.
"""

from dynahoi_lerobot.env import register_envs
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

register_envs()

__all__ = ["DynahoiEnvConfig"]
