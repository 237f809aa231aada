"""Pre- and postprocessing: LeRobot's defaults, which map the 1st and 99th percentile of actions to
-1 and 1.
"""

from lerobot.processor.factory import make_default_pre_post_processors

make_upvla_pre_post_processors = make_default_pre_post_processors
"""LeRobot looks for this name."""
