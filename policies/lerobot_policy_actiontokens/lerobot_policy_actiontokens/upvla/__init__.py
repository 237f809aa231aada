"""Seeing ahead and acting in one pass, after UP-VLA: ``lerobot-train --policy.type=upvla``."""

from .configuration_upvla import UPVLAConfig
from .modeling_upvla import UPVLAPolicy
from .processor_upvla import make_upvla_pre_post_processors

__all__ = ["UPVLAConfig", "UPVLAPolicy", "make_upvla_pre_post_processors"]
