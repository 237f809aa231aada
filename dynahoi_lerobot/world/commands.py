"""What hands are told: actions become commands, are cut to the limits of a hand, wait, and become
servo set points.
"""

import numpy as np

from dynahoi_lerobot.captures import CaptureRule
from dynahoi_lerobot.core.control_mode import CONTROL_MODES, GRASP, JOINTS, from_grasp, to_grasp
from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, HAND_NAMES, PALM_DOF, SUBSTEPS
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.scene.scene import Scene

ROUNDING = 1e-5
"""Relative excess that counts as rounding: replaying a stored, cut command must not cut it
again."""
IS_PALM = np.arange(HAND_DOF) < PALM_DOF


class Commands:
    """The commands of N worlds, palm positions [m], home frame, and joint angles [rad].

    A command is cut when it is given, to what the hand can meet when it takes effect; so it is
    followed as it was given, and replaying it repeats the episode to the bit.

    Attributes:
        palm_speed_m_s: greatest speed of the palm [m/s]: the control class's limit, or the limit of
            the capture rule's gantry.
        low, high: (18,) least and greatest position of the palm along each slide [m], world, and
            joint angles [rad].
        given: (N, 18) the command last given, as it was cut.
        executed: (N, 18) set points that the servos last received.
        when_due: (N, 18) where undisturbed hands will be when a command given now takes effect.
    """

    def __init__(
        self, size: int, scene: Scene, rule: CaptureRule, control: ControlClass, mode: str
    ) -> None:
        """Read gains and joint ranges of the 18 actuated joints from the model of ``scene``; no
        hand moves yet.

        Args:
            size: N.
            scene: with the hand.
            rule: may replace the control class's limit of the palm, by one for each axis of its
                gantry.
            control: limits and latency of the hand.
            mode: the control mode of actions.
        """
        model = scene.model
        joints = [scene.model.joint(name).id for name in HAND_NAMES]
        self.low, self.high = model.jnt_range[joints].T.copy()
        damping = model.dof_damping[model.jnt_dofadr[joints]] - model.actuator_biasprm[:HAND_DOF, 2]
        self._lead_s = damping / model.actuator_gainprm[:HAND_DOF, 0]
        self.palm_speed_m_s = rule.palm_speed_m_s(control)
        self._by_axis = rule.gantry_speed_m_s is not None
        self._farthest_m = self.palm_speed_m_s * CONTROL_DT
        self._farthest_rad = control.joint_speed_rad_s * CONTROL_DT
        self._mode = mode
        self._open_and_closed = (scene.hand.open_joints(), scene.hand.closed_joints())
        self._range_h = np.zeros((2, size, HAND_DOF))
        self.given = np.zeros((size, HAND_DOF))
        self._way = np.zeros(
            (control.latency_frames + 1, size, HAND_DOF)
        )  # as followed, from now to the last given
        self.executed = self._way[0]
        self.when_due = self._way[-1]

    def begin(self, i: int, rest: np.ndarray, origin: np.ndarray) -> None:
        """Let the hand of world ``i`` rest at (18,) ``rest``; (18,) ``origin`` is the origin of its
        home frame, world.
        """
        self._range_h[:, i] = self.low - origin, self.high - origin
        self._way[1:, i] = np.clip(rest, *self._range_h[:, i])
        self.given[i] = self.executed[i] = rest

    def read(self, actions: np.ndarray, state: np.ndarray, mode: str | None = None) -> np.ndarray:
        """Return (N, 18) the commands of actions.

        Args:
            actions: (N, 4) in control mode ``grasp``, else (N, 18) commands.
            state: (N, 18) of the hands, from which displacements are counted.
            mode: control mode of the actions; by default the worlds' own.

        Raises:
            ValueError: for a wrong shape, or a value that is not a finite real number.
        """
        count = len(self.given)
        if (mode or self._mode) == JOINTS:
            return _checked(actions, count)
        given = _checked(actions, count, len(CONTROL_MODES[GRASP]))
        return from_grasp(given, _as_observed(state), *self._open_and_closed)

    def labels(self, goals: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return (N, 18) or (N, 4) the actions, in the control mode, of a teacher's goals, cut to
        slides and joints.

        Args:
            goals: (N, 18) palm positions and joint angles.
            state: as for ``read``.
        """
        commands = np.clip(goals, *self._range_h)
        return (
            commands
            if self._mode == JOINTS
            else to_grasp(commands, _as_observed(state), *self._open_and_closed)
        )

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (18,) or (4,) least and greatest actions in any episode, float32, in the
        control mode.

        The palm's are the whole length of each slide either way: where on them the home lies is not
        told.
        """
        length = self.high - self.low
        ends = np.where(IS_PALM, -length, self.low), np.where(IS_PALM, length, self.high)
        low, high = (end.astype(np.float32) for end in ends)
        if self._mode == JOINTS:
            return low, high
        return np.append(low[:PALM_DOF], np.float32(0)), np.append(high[:PALM_DOF], np.float32(1))

    def follow(self, ids: np.ndarray, wanted: np.ndarray, accepting: np.ndarray) -> np.ndarray:
        """Take commands and pass one control step.

        Each frame's command is ramped linearly, with velocity feed-forward. A position servo
        ``kp (u - q) - kv q'`` lags behind a moving set point by kv / kp times its speed, and a
        joint that is damped itself by its damping / kp more; adding that to u makes the joint
        arrive at the command exactly at the end of the frame.

        Args:
            ids: (n,) worlds.
            wanted: (n, 18) commands.
            accepting: (n,) bool, whether each takes effect; a void one becomes holding still.

        Returns:
            (n, 25, 18) the servos' set points, from what was executed before to what is due now.
        """
        before = self.executed[ids]
        # taken as it is stored, in single precision, so that a replay of stored actions is the same
        # to the bit
        stored = self.within_reach(wanted, self.when_due[ids], *self._range_h[:, ids]).astype(
            np.float32
        )
        given = self.given[ids] = np.where(accepting[:, None], stored.astype(np.float64), before)
        self._way[:-1, ids] = self._way[1:, ids]
        self._way[-1, ids] = np.clip(given, *self._range_h[:, ids])
        return self.set_points(self.executed[ids], before)

    def within_reach(
        self, command: np.ndarray, previous: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        """Return (n, 18) commands towards ``command`` that a hand at ``previous`` can reach within
        one frame.

        A palm that cannot get there keeps its direction, unless its limit holds for each axis. All
        are (n, 18), in one frame of reference; ``low`` and ``high`` are the ends of slides and
        joint ranges.
        """
        step = command - previous
        palm = step[:, :PALM_DOF]
        joints = step[:, PALM_DOF:]
        length = np.abs(palm) if self._by_axis else np.linalg.norm(palm, axis=1, keepdims=True)
        palm = _shortened(palm, length, self._farthest_m)
        joints = _shortened(joints, np.abs(joints), self._farthest_rad)
        cut = np.concatenate([palm, joints], axis=1)
        return np.clip(np.where(cut == step, command, previous + cut), low, high)

    def set_points(self, command: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """Return (n, 25, 18) set points that lead from ``previous`` to ``command``, (n, 18)
        each.
        """
        change = (command - previous)[:, None]
        progress = (np.arange(SUBSTEPS) / SUBSTEPS)[
            :, None
        ]  # where each joint should be when the step begins
        return previous[:, None] + progress * change + self._lead_s * change / CONTROL_DT


def _checked(actions: np.ndarray, count: int, size: int = HAND_DOF) -> np.ndarray:
    """(count, size) float64; a ValueError for what ``read`` refuses names the world, the index and
    the value.
    """
    given = np.asarray(actions)
    if given.dtype.kind not in "fiu":
        raise ValueError(f"action must hold real numbers, got dtype {given.dtype}")
    values = given.astype(np.float64)
    if values.shape != (count, size):
        raise ValueError(f"action must have shape ({count}, {size}), got {values.shape}")
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        world, dof = bad[0]
        raise ValueError(
            f"action of world {world} must be finite, got {values[world, dof]} at index {dof}"
        )
    return values


def _as_observed(state: np.ndarray) -> np.ndarray:
    """A state rounded as observations hold it."""
    return state.astype(np.float32).astype(np.float64)


def _shortened(step: np.ndarray, length: np.ndarray, farthest: float) -> np.ndarray:
    """Scale steps that are longer than ``farthest``; rounding to single precision makes none too
    long.
    """
    return np.where(
        length > farthest * (1 + ROUNDING), step * (farthest / np.maximum(length, farthest)), step
    )
