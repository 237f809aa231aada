"""The simulated hand of DynaHOI as a LeRobot robot, ``--robot.type=dynahoi``, and its
teleoperators.

LeRobot imports this package by its distribution name; importing it registers the configs, and
checks the command line.
"""

from importlib.metadata import version

from lerobot_robot_dynahoi.checks import check_command_line
from lerobot_robot_dynahoi.config_dynahoi import (
    DynahoiBrowserConfig,
    DynahoiExpertConfig,
    DynahoiRobotConfig,
)
from lerobot_robot_dynahoi.dynahoi import DynahoiRobot
from lerobot_robot_dynahoi.teleoperators import DynahoiBrowser, DynahoiExpert

__version__ = version("lerobot_robot_dynahoi")

check_command_line()

__all__ = [
    "DynahoiBrowser",
    "DynahoiBrowserConfig",
    "DynahoiExpert",
    "DynahoiExpertConfig",
    "DynahoiRobot",
    "DynahoiRobotConfig",
]
