"""Actions from -1 to 1, from which reinforcement learning starts, for control mode ``grasp``."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.wrappers import TransformAction
from gymnasium.wrappers.vector import TransformAction as TransformActions

from dynahoi_lerobot.core.control_mode import GRASP
from dynahoi_lerobot.core.conventions import CONTROL_DT, PALM_DOF
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES

UNIT_ACTIONS = spaces.Box(-1.0, 1.0, (PALM_DOF + 1,), np.float32)


def unit_actions[E: (gym.Env, VectorEnv)](env: E) -> E:
    """Return an environment in control mode ``grasp`` whose actions are four numbers u, -1 to 1.

    The palm's displacement is u[:3] times its largest step, which is 2.5 cm in control
    class ``standard``; ``closing`` is (1 + u[3]) / 2. To catch, ``closing`` must reach 0.81 to 1,
    depending on the object.

    Args:
        env: one world, or a vector environment.

    Raises:
        ValueError: in another control mode.
    """
    base: Any = env.unwrapped
    rules = (base if isinstance(env, VectorEnv) else base._vector).recipe.rules
    if rules.control_mode != GRASP:
        raise ValueError(f"unit actions need control_mode {GRASP!r}, got {rules.control_mode!r}")
    step_m = CONTROL_CLASSES[rules.control_class].palm_speed_m_s * CONTROL_DT

    def as_grasp(actions: np.ndarray) -> np.ndarray:
        palm = step_m * actions[..., :PALM_DOF]
        closing = (1 + actions[..., PALM_DOF:]) / 2
        return np.concatenate([palm, closing], axis=-1)

    if isinstance(env, VectorEnv):
        return TransformActions(env, as_grasp, single_action_space=UNIT_ACTIONS)  # type: ignore[return-value]
    return TransformAction(env, as_grasp, UNIT_ACTIONS)  # type: ignore[return-value]
