"""The registry of experts and privileged baselines."""

from dynahoi_lerobot.core.agent import Expert
from dynahoi_lerobot.core.registry import Registry

EXPERTS: Registry[type[Expert]] = Registry("expert", Expert)
