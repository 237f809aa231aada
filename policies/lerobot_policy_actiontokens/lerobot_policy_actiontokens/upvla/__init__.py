"""UP-VLA: joint prediction of a future image and a chunk of actions, ``lerobot-train --policy.type=upvla``."""

from .configuration_upvla import UPVLAConfig
from .modeling_upvla import UPVLAPolicy
from .processor_upvla import make_upvla_pre_post_processors

__all__ = ["UPVLAConfig", "UPVLAPolicy", "make_upvla_pre_post_processors"]
