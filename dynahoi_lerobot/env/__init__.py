"""The Gymnasium environments: ``DynahoiVectorEnv`` (native, N worlds), ``DynahoiEnv`` (one), and their registration."""

from dynahoi_lerobot.env.vector_env import DynahoiEnv, DynahoiVectorEnv, register_envs

__all__ = ["DynahoiEnv", "DynahoiVectorEnv", "register_envs"]
