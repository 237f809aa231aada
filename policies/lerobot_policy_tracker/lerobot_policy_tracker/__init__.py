"""The engineered tracker as a LeRobot policy plugin: ``lerobot-train --policy.type=tracker``."""

from importlib.metadata import version

from .configuration_tracker import TrackerConfig
from .modeling_tracker import TrackerPolicy
from .processor_tracker import make_tracker_pre_post_processors

__version__ = version("lerobot_policy_tracker")

__all__ = ["TrackerConfig", "TrackerPolicy", "make_tracker_pre_post_processors"]
