"""ObAct as a LeRobot policy plugin: ``lerobot-train --policy.type=obact``."""

from importlib.metadata import version

from .configuration_obact import ObActConfig
from .modeling_obact import ObActPolicy
from .processor_obact import make_obact_pre_post_processors

__version__ = version("lerobot_policy_obact")

__all__ = ["ObActConfig", "ObActPolicy", "make_obact_pre_post_processors"]
