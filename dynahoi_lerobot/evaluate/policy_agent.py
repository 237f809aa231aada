"""A trained LeRobot policy as an agent: LeRobot's own loading, processors and action selection.

Nothing here imports torch or LeRobot before a policy is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.agent import Agent, Observation
from dynahoi_lerobot.env.spaces import as_gym
from dynahoi_lerobot.features import CAMERA_KEY, IMAGE_PREFIX
from dynahoi_lerobot.renderers.views import FURTHER_VIEWS

REMEDY = "give a pretrained_model folder, a Hub repository (user/name), or one of the experts"


class PolicyError(ValueError):
    """A policy that cannot be loaded; the message says what was asked for and what would do."""


class PolicyAgent(Agent):
    """Plays a checkpoint folder or a Hub repository, exactly as ``lerobot-eval`` would."""

    def __init__(self, path: str, device: str | None = None, settings: Sequence[str] = ()) -> None:
        """Load the policy and its processors.

        Args:
            path: a ``pretrained_model`` folder, or a Hub repository id.
            device: torch device, the policy's own if None.
            settings: changes of its config, ``KEY=VALUE`` each.

        Raises:
            PolicyError: if there is no such policy, or its config cannot be changed so.
        """
        self.name = path
        self._policy, self._before, self._after = _load(path, device, settings)
        inputs = self._policy.config.input_features
        self.sees_images = any(key.startswith("observation.image") for key in inputs)
        self.image_size = int(inputs[CAMERA_KEY].shape[-1]) if CAMERA_KEY in inputs else None
        self.views = tuple(view for view in FURTHER_VIEWS if IMAGE_PREFIX + view in inputs)

    def reset(self, count: int) -> None:
        """Forget queued actions and history."""
        self._policy.reset()

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) commands."""
        import torch
        from lerobot.envs.utils import preprocess_observation

        batch: dict[str, Any] = preprocess_observation(as_gym(observation))
        batch["task"] = list(observation.tasks)
        with torch.inference_mode():
            action = self._policy.select_action(self._before(batch))
        return self._after(action).to("cpu").numpy()


def _load(path: str, device: str | None, settings: Sequence[str]) -> tuple[Any, Any, Any]:
    """Policy, preprocessor and postprocessor."""
    try:
        from lerobot.configs import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        from lerobot.utils.import_utils import register_third_party_plugins
    except ImportError as error:
        raise PolicyError(f"playing a policy needs LeRobot ({error}); install dynahoi_lerobot[lerobot]") from error
    register_third_party_plugins()
    config = _config(PreTrainedConfig, path, settings)
    if device is not None:
        config.device = device
    policy = get_policy_class(config.type).from_pretrained(path, config=config).eval()
    overrides = {"device_processor": {"device": str(config.device)}}
    before, after = make_pre_post_processors(config, pretrained_path=path, preprocessor_overrides=overrides)
    return policy, before, after


def _config(config_class: Any, path: str, settings: Sequence[str]) -> Any:
    if not Path(path).is_dir() and path.count("/") != 1:
        raise PolicyError(f"there is no policy {path!r}; {REMEDY}")
    if Path(path).is_dir() and not (Path(path) / "config.json").is_file():
        nested = sorted(str(p.parent) for p in Path(path).glob("**/pretrained_model/config.json"))
        hint = f"; did you mean {nested[-1]}?" if nested else ""
        raise PolicyError(f"{path} holds no policy (no config.json){hint}")
    try:
        config = config_class.from_pretrained(path)
    except Exception as error:
        raise PolicyError(f"there is no policy {path!r} ({type(error).__name__}); {REMEDY}") from error
    return _changed(config, path, settings) if settings else config


def _changed(config: Any, path: str, settings: Sequence[str]) -> Any:
    """Open the config again with ``settings``, through LeRobot's own parser."""
    known = [field.name for field in fields(config)]
    for setting in settings:
        key, equals, _ = setting.partition("=")
        if not equals or key not in known:
            raise PolicyError(f"cannot set {setting!r}: must be KEY=VALUE, KEY one of {', '.join(known)}")
    try:
        return config.from_pretrained(path, cli_overrides=[f"--{setting}" for setting in settings])
    except Exception as error:
        raise PolicyError(f"cannot set {', '.join(settings)}: {error.__cause__ or error}") from error
