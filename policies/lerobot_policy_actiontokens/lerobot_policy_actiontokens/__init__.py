"""Language models that predict actions, as LeRobot policies: ``--policy.type=actiontokens`` and
``=upvla``.
"""

from importlib.metadata import version

from .configuration_actiontokens import ActionTokensConfig
from .configuration_upvla import UPVLAConfig
from .modeling_actiontokens import ActionTokensPolicy
from .modeling_upvla import UPVLAPolicy
from .processor_actiontokens import make_actiontokens_pre_post_processors
from .processor_upvla import make_upvla_pre_post_processors

__version__ = version("lerobot_policy_actiontokens")

__all__ = [
    "ActionTokensConfig",
    "ActionTokensPolicy",
    "UPVLAConfig",
    "UPVLAPolicy",
    "make_actiontokens_pre_post_processors",
    "make_upvla_pre_post_processors",
]
