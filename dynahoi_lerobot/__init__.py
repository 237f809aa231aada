"""Catching moving things with a dexterous hand: generator, environment and metrics, native to
LeRobot.
"""

from importlib.metadata import version

__version__ = version("dynahoi_lerobot")
