"""ObAct, observe before act, as a LeRobot policy plugin: ``lerobot-train --policy.type=obact``."""

from .configuration_obact import ObActConfig
from .modeling_obact import ObActPolicy
from .processor_obact import make_obact_pre_post_processors

__all__ = ["ObActConfig", "ObActPolicy", "make_obact_pre_post_processors"]
