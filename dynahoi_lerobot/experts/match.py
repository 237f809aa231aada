"""Catching by contact: move along with the target, come up from behind it, close, and brake with it
in the hand.
"""

import numpy as np

from dynahoi_lerobot.core.agent import Expert, Meeting, WorldView
from dynahoi_lerobot.core.conventions import CONTROL_DT, GANTRY_SPEED_M_S, PALM_DOF
from dynahoi_lerobot.core.numerics import norm
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts.base import EXPERTS
from dynahoi_lerobot.experts.intercept import closed_joints

SEAT_M = np.array([-0.006, 0.0, 0.004])
"""(3,) where the center of a held target is, from the palm center; the palm faces along x."""
BEHIND_M = 0.06
"""The hand waits this far behind the target, along the palm's normal, until it is in line."""
IN_LINE_M, OUT_OF_LINE_M = 0.005, 0.105
"""Lateral distances from the palm's axis: up to the first the hand closes in, from the second it
keeps `BEHIND_M`."""
PRESS_M = 0.02
"""In line, the palm presses this far beyond the seat."""
DETOUR_M, AHEAD_M = 0.13, 0.01
"""A palm more than `AHEAD_M` in front of the target first moves sideways, until it is `DETOUR_M`
off the axis."""
STEP_M, CLOSING_STEP_M = 0.05, 0.015
"""Greatest displacement relative to the target in a frame, in general and when closing in along the
normal."""
LATERAL_SHARE = 0.7
"""Share of a small lateral error that is corrected in a frame."""
CLOSES_M, CLOSES_AT_M, CLOSES_AHEAD_M = 0.0225, -0.017, 0.03
"""Fingers close within `CLOSES_M` of the axis, from `CLOSES_AT_M` to `CLOSES_AHEAD_M` along the
normal."""
SQUEEZE_RAD = 0.3
"""Joints are commanded this far beyond the closed pose, which produces the grip force."""
HELD_M, HELD_SHARE = 0.05, 0.5
"""Fingers closed by more than `HELD_SHARE` are taken to hold a target within `HELD_M` of its
seat."""
BRAKE_SHARE, LIFT_M_S = 0.15, np.array([0.0, 0.0, 0.15])
"""In each frame, the velocity of a held target changes by `BRAKE_SHARE` of its difference from
`LIFT_M_S`."""
LONGEST_WAY_M = GANTRY_SPEED_M_S * CONTROL_DT
"""Greatest displacement of the palm in a frame, along each axis."""
ON_PATH_M = 0.01
"""A target farther than this from its path has been touched."""


@EXPERTS.register("match")
class Match(Expert):
    """Velocity-matched approach with a power grasp, for the capture rule ``contact``; a function of
    the state.
    """

    labels_any_state = True

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        return self.goal(world)

    def goal(self, world: WorldView) -> np.ndarray:
        """Return (18,) where the hand should be one frame later, which labels any state."""
        spec = world.spec
        palm = world.state[:PALM_DOF]
        opened = spec.open_joints
        closed = closed_joints(spec.hand)
        squeezed = closed + SQUEEZE_RAD
        now, ahead = _target(world)
        offset = palm - (now - SEAT_M)
        share = norm(world.state[PALM_DOF:] - opened) / norm(closed - opened)
        if share > HELD_SHARE and norm(offset) < HELD_M:
            return np.concatenate([palm + braked(world.target_velocity_w) * CONTROL_DT, squeezed])
        offset, closes = approach(offset)
        return np.concatenate([ahead - SEAT_M + offset, squeezed if closes else opened])

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass) -> Meeting:
        """Return where the fingers begin to close, for a hand that starts at home."""
        path = spec.target_path_w - SEAT_M
        frame = spec.window_frames
        palm = spec.home_pos_w
        closes = np.array(False)
        while not closes and frame + 1 < len(path):
            offset, closes = approach(palm - path[frame])
            frame += 1
            palm = palm + np.clip(path[frame] + offset - palm, -LONGEST_WAY_M, LONGEST_WAY_M)
        return Meeting(palm, frame)


def approach(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where an open hand should be relative to the target one frame later, and whether to
    close the fingers.

    Args:
        offset: (..., 3) of the palm center from where it is when the target is in its seat [m],
            world.

    Returns:
        (..., 3) [m], world, and (...) bool.
    """
    along = offset[..., 0]
    across = offset[..., 1:]
    distance = np.sqrt(across[..., 0] ** 2 + across[..., 1] ** 2)
    out = np.clip((distance - IN_LINE_M) / (OUT_OF_LINE_M - IN_LINE_M), 0.0, 1.0)
    fastest = CLOSING_STEP_M + np.clip(-BEHIND_M - along, 0.0, STEP_M - CLOSING_STEP_M)
    forward = np.clip(PRESS_M * (1 - out) - BEHIND_M * out - along, -STEP_M, fastest)
    unit = across / np.maximum(distance, 1e-9)[..., None]
    inwards = -np.minimum(LATERAL_SHARE * distance, STEP_M)
    outwards = np.minimum(DETOUR_M - distance, STEP_M)
    sideways = np.where((along > AHEAD_M) & (distance < DETOUR_M), outwards, inwards)
    ahead = along + forward
    closes = (distance <= CLOSES_M) & (ahead >= CLOSES_AT_M) & (along < CLOSES_AHEAD_M)
    return np.concatenate([ahead[..., None], across + sideways[..., None] * unit], axis=-1), closes


def braked(velocity: np.ndarray) -> np.ndarray:
    """Return the velocity (..., 3) [m/s] of a hand one frame later that brakes and lifts the target
    it holds.
    """
    return velocity + (LIFT_M_S - velocity) * BRAKE_SHARE


def _target(world: WorldView) -> tuple[np.ndarray, np.ndarray]:
    """Return (3,) where the target is when the command takes effect, and a frame later [m],
    world.
    """
    path = world.spec.target_path_w
    if norm(world.target_pos_w - path[min(world.frame, len(path) - 1)]) > ON_PATH_M:
        return world.target_pos_w, world.target_pos_w + world.target_velocity_w * CONTROL_DT
    due = min(world.due_frame, len(path) - 2)
    return path[due], path[due + 1]
