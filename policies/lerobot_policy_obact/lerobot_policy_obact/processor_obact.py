"""Pre- and postprocessing: LeRobot's default pipelines, so that every override of those works.

The config asks for no normalization: the policy works in meters and radians.
"""

from lerobot.processor.factory import make_default_pre_post_processors

# LeRobot looks it up by this name
make_obact_pre_post_processors = make_default_pre_post_processors
