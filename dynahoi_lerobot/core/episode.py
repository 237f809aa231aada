"""Episode: the narrow waist. The expert writes it, the dataset stores it, metrics read it."""

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import (
    GRASP_FRACTION,
    LARGEST_GRASP_FRACTION,
    PALM_DOF,
    UNIT_M,
)


@dataclass(frozen=True)
class EpisodeMeta:
    """What an episode was: one value per episode, each a column of the dataset's episode table.

    Attributes:
        seed: the seed that determines everything drawn for the episode.
        split: the seed stream it belongs to (``train``, ``val``, ``test``, ``ood_*``), and digits
            of a salt's hash.
        motion: kind of motion, one of the 22 names.
        category: its category, one of the 8 names.
        object: the object's name, one of the 11.
        parameters: the motion's parameters, JSON with SI units, world frame.
        task: the instruction given to the policy.
        agent: who moved the hand (``intercept``, ``hold``, a policy's name; in an on-policy
            recording type and hash of its checkpoint, ``obact@...``).
        capture: the capture rule, ``attach``, ``attach_lenient`` or ``contact``.
        protocol: one of ``protocols.PROTOCOLS``.
        control_class: limits of the hand and latency of its commands, ``unlimited``, ``standard``
            or ``late``.
        control_mode: what an action is, ``joints`` or ``grasp``.
        window_frames: length of the observation window [frames].
        length_frames: L, the length of the expert's recording [frames]; a policy gets L control
            steps.
        intercept_frame: frame at which the oracle intercept takes place, counted from the episode's
            start.
        attempts: how many attempts the agent needed, from 1.
        code: fingerprint of the code that made the episode.
        benchmark: identifies the benchmark that the episode was drawn and played under.
    """

    seed: int
    split: str
    motion: str
    category: str
    object: str
    parameters: str
    task: str
    agent: str
    capture: str
    protocol: str
    control_class: str
    control_mode: str
    window_frames: int
    length_frames: int
    intercept_frame: int
    attempts: int
    code: str
    benchmark: str


@dataclass(frozen=True, eq=False, repr=False)
class Episode:
    """One rollout of T frames at 20 Hz; frame t holds an observation and the command that followed.

    Home frame, SI units. ``state[t]`` is measured at time t * 0.05 s, ``given_action[t]`` is the
    command given then and ``executed_action[t]`` the one that the hand executed until frame t + 1;
    they differ by the control class's latency. The window is frames ``[0, window_frames)``; control
    starts at frame ``window_frames``.

    `features.py` has shape, unit, element type and meaning of every array, and so does ``dynahoi
    list features``: one row per frame, (T, ...), where it says nothing else.

    Attributes:
        meta: one value per episode.
        images: (T, H, W, 3) uint8 RGB by view, ``ego`` (the hand's camera) first; empty if nothing
            was rendered.
        action: in recordings for learning the teacher's goal, which may lie beyond the reach of one
            frame, also in the window, where commands are void; elsewhere ``given_action``. (T, 4)
            where the control mode is ``grasp``.
        target_path_h: (F, 3), F = window + L + 1, as long as an evaluation may last, so it extends
            beyond the end of a recorded catch.
        palm_distance_m: the least within the control step that ends at the frame, so that a fast
            target cannot pass between two frames unseen.
        localized: under ``attach``, the target is also welded to the hand.
        object_primitives: (S, 11), one row per solid, see ``objects.primitives.as_table``.
        success: the capture rule's verdict on the whole episode.
        stage: how far it got: ``missed``, ``localized``, ``captured`` (rule ``attach``) or
            ``missed``, ``touched``, ``enclosed``, ``slipped``, ``held`` (rule ``contact``).
        touch: None unless the capture rule ``uses_contact_sensors``.
        sighting: None unless the recipe's ``environment_state`` is ``eye``.
    """

    meta: EpisodeMeta
    images: dict[str, np.ndarray]
    state: np.ndarray
    fingertips: np.ndarray
    phase: np.ndarray
    action: np.ndarray
    given_action: np.ndarray
    executed_action: np.ndarray
    target_pose_h: np.ndarray
    target_velocity_w: np.ndarray
    target_path_h: np.ndarray
    target_contacts: np.ndarray
    palm_distance_m: np.ndarray
    fingertip_distance_m: np.ndarray
    localized: np.ndarray
    captured: np.ndarray
    intercept_pos_h: np.ndarray
    intercept_s: float
    home_pos_w: np.ndarray
    open_joints: np.ndarray
    reference_joints: np.ndarray
    succeeded: np.ndarray
    object_primitives: np.ndarray
    object_size: np.ndarray
    object_mass_kg: float
    object_inertia: np.ndarray
    object_friction: np.ndarray
    object_restitution: float
    ego_camera_pose_palm: np.ndarray
    side_camera_pose_h: np.ndarray
    ego_intrinsics: np.ndarray
    side_intrinsics: np.ndarray
    hand_limits: np.ndarray
    first_plan: np.ndarray
    success: bool
    stage: str
    touch: np.ndarray | None = None
    sighting: np.ndarray | None = None

    def __len__(self) -> int:
        """Return T, the number of frames."""
        return len(self.state)

    def __repr__(self) -> str:
        return f"Episode({self.meta}, {len(self)} frames, {self.stage})"

    @property
    def control(self) -> slice:
        """Frames of the control phase."""
        return slice(self.meta.window_frames, len(self))

    @property
    def palm_pos_h(self) -> np.ndarray:
        """(T, 3) palm center positions [m], home frame."""
        return self.state[:, :PALM_DOF]

    @property
    def joints(self) -> np.ndarray:
        """(T, 15) joint angles [rad]."""
        return self.state[:, PALM_DOF:]

    @property
    def environment_state(self) -> np.ndarray:
        """(T, 13) float32, ``target_pose_h`` and ``target_velocity_w``, which a dataset on request
        shows to policies.
        """
        return np.concatenate([self.target_pose_h, self.target_velocity_w], axis=1)

    @property
    def reward(self) -> np.ndarray:
        """(T,) float32, the dense reward of the environment: 1 where the action leads to the first
        frame on which the episode is a success, and in the control phase the change of
        `potential`; 0 for the last action, whose outcome is not recorded.
        """
        distance_m = np.linalg.norm(self.target_pose_h[:, :3] - self.palm_pos_h, axis=1)
        closed = closure(self.joints, self.open_joints, self.reference_joints)
        change = np.diff(potential(distance_m, closed), append=0.0)
        change[: self.meta.window_frames] = 0.0
        change[-1] = 0.0
        return (np.diff(self.succeeded, prepend=False) + change).astype(np.float32)

    @property
    def done(self) -> np.ndarray:
        """(T,) bool, True for the last frame of the recording."""
        return np.arange(len(self)) == len(self) - 1

    @property
    def attempt_success(self) -> np.ndarray:
        """(attempts,) bool, whether each attempt succeeded: all but the last, which is recorded
        here, have failed.
        """
        return np.array([False] * (self.meta.attempts - 1) + [self.success])

    @property
    def first_localized(self) -> int | None:
        """The first localized frame of the control phase, or None (Section 5, "task
        completion").
        """
        hits = np.flatnonzero(self.localized[self.control])
        return int(hits[0]) + self.meta.window_frames if hits.size else None


def joints_reached(
    joints: np.ndarray, open_joints: np.ndarray, reference: np.ndarray
) -> np.ndarray:
    """Tell which joints turned in the reference's direction by at least 0.9 of its rotation.

    The pose criterion of Appendix "Evaluation Criteria". A joint that the reference leaves open
    counts as reached.

    Args:
        joints: (..., 15) joint angles [rad].
        open_joints: (15,) angles of the open hand [rad].
        reference: (15,) angles of the reference grasp [rad].

    Returns:
        (..., 15) bool.
    """
    rotation = joints - open_joints
    wanted = reference - open_joints
    return rotation * np.sign(wanted) >= GRASP_FRACTION * np.abs(wanted) - 1e-6


def closure(joints: np.ndarray, open_joints: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return how far a hand is closed as the reference grasp demands, 0 (open) to 1.

    The mean over the joints that the reference turns, each 1 within 0.9 to 1.2 of its rotation and
    falling off linearly on either side.

    Args:
        joints: (..., 15) joint angles [rad].
        open_joints: (..., 15) angles of the open hand [rad].
        reference: (..., 15) angles of the reference grasp [rad].

    Returns:
        (...,) in [0, 1].
    """
    wanted = reference - open_joints
    turned = np.abs(wanted) > 1e-6
    share = (joints - open_joints) / np.where(turned, wanted, 1.0)
    off = np.maximum(GRASP_FRACTION - share, share - LARGEST_GRASP_FRACTION)
    reached = 1.0 - np.clip(off / GRASP_FRACTION, 0.0, 1.0)
    return (reached * turned).sum(axis=-1) / np.maximum(turned.sum(axis=-1), 1)


def potential(distance_m: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Return how promising a state is: ``-d + c exp(-d)``, with d the distance from palm center to
    target center in units of 0.1 m, and c the `closure`.

    The first term draws the palm to the target, the second, 0 to 1, closes the hand near it: a
    grasp of 0.8 is worth more than one of 0.7, although only 0.9 is a success.

    Args:
        distance_m: (...,) [m].
        closed: (...,) in [0, 1].
    """
    distance_u = distance_m / UNIT_M
    return closed * np.exp(-distance_u) - distance_u


def in_reference_grasp(
    joints: np.ndarray, open_joints: np.ndarray, reference: np.ndarray
) -> np.ndarray:
    """Tell whether all joints that the reference turns have made 0.9 to 1.2 of its rotation, which
    a fist has not.

    The one rule of success under the capture rules that weld, and of the two-sided metrics.

    Args:
        joints: (..., 15) joint angles [rad].
        open_joints: (15,) angles of the open hand [rad].
        reference: (15,) angles of the reference grasp [rad].

    Returns:
        (...,) bool.
    """
    wanted = np.abs(reference - open_joints)
    beyond = np.abs(joints - open_joints) > LARGEST_GRASP_FRACTION * wanted + 1e-6
    matches = joints_reached(joints, open_joints, reference) & ~beyond
    return np.asarray((matches | (wanted <= 1e-6)).all(axis=-1))
