"""The simulated hand of DynaHOI as a LeRobot robot, ``--robot.type=dynahoi``, and its teleoperators.

LeRobot imports this package by its distribution name; importing it registers the configs.
"""

from importlib.metadata import version

from lerobot_robot_dynahoi.config_dynahoi import DynahoiExpertConfig, DynahoiRobotConfig
from lerobot_robot_dynahoi.dynahoi import DynahoiExpert, DynahoiRobot

__version__ = version("lerobot_robot_dynahoi")

__all__ = ["DynahoiExpert", "DynahoiExpertConfig", "DynahoiRobot", "DynahoiRobotConfig"]
