"""Pre- and postprocessing: LeRobot's own."""

from lerobot.processor.factory import make_default_pre_post_processors


def make_forward_pre_post_processors(config, dataset_stats=None):
    return make_default_pre_post_processors(config, dataset_stats)
