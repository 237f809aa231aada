"""The benchmark as an environment on the Hub.

Upload this file as ``env.py`` of a Hub repository, with ``lerobot_env_dynahoi`` installed where it
is used:

    make_env("you/dynahoi-env", n_envs=8, trust_remote_code=True)
"""

from typing import Any

from lerobot_env_dynahoi import DynahoiEnvConfig


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, Any]]:
    """Return one suite per category of motion and one vector env per kind.

    Args:
        n_envs: worlds in each.
        use_async_envs: has no effect: each env is one native batch.
        cfg: a ``DynahoiEnvConfig`` config; another one's ``task`` selects kinds or categories.
    """
    config = (
        cfg
        if isinstance(cfg, DynahoiEnvConfig)
        else DynahoiEnvConfig(task=getattr(cfg, "task", None))
    )
    return config.create_envs(n_envs, use_async_envs)
