"""The Gymnasium environments: ``DynahoiVectorEnv`` (native, N worlds), ``DynahoiEnv`` (one), and their registration."""

from dynahoi_lerobot.env.registration import register_envs
from dynahoi_lerobot.env.single_env import DynahoiEnv
from dynahoi_lerobot.env.vector_env import DynahoiVectorEnv

__all__ = ["DynahoiEnv", "DynahoiVectorEnv", "register_envs"]
