"""A baseline that knows where the target is and how fast, and believes that it will keep its velocity."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.agent import Expert, WorldState
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.base import CLOSING_FRAMES, EXPERTS
from dynahoi_lerobot.foundation.conventions import CONTROL_DT, HAND_DOF, HAND_SPEED_M_S, PALM_DOF

HORIZON_FRAMES = 60


@EXPERTS.register("constant_velocity")
class ConstantVelocity(Expert):
    """Perfect perception, no model of the motion: replans every frame to the earliest point of a straight line."""

    name = "constant_velocity"

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) commands; worlds without an episode get zeros."""
        commands = np.zeros((len(world.specs), HAND_DOF))
        for i, spec in enumerate(world.specs):
            if spec is not None:
                state = world.observation.state[i].astype(np.float64)
                commands[i] = _chase(spec, state, world.target_pose[i, :3], world.target_velocity[i, :3])
        return commands


def _chase(spec: EpisodeSpec, state: np.ndarray, target_pos_w: np.ndarray, target_velocity_w: np.ndarray) -> np.ndarray:
    """One frame towards the meeting point, fingers closing over the frames that are left."""
    palm = state[:PALM_DOF]
    frames = np.arange(1, HORIZON_FRAMES + 1)[:, None]
    predicted = target_pos_w + frames * CONTROL_DT * target_velocity_w
    distance = np.linalg.norm(predicted - palm, axis=1)
    reachable = np.flatnonzero(distance <= HAND_SPEED_M_S * CONTROL_DT * frames[:, 0])
    left = int(reachable[0]) if reachable.size else HORIZON_FRAMES - 1
    closed = spec.reference_joints
    share = 1.0 / max(1, min(left, CLOSING_FRAMES))
    joints = state[PALM_DOF:] + (closed - state[PALM_DOF:]) * share * (left <= CLOSING_FRAMES)
    return np.concatenate([palm + (predicted[left] - palm) / (left + 1), joints])
