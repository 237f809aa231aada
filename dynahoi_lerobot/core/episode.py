"""Episode: the narrow waist. The expert writes it, the dataset stores it, metrics read it."""

from dataclasses import dataclass, field

import numpy as np

from dynahoi_lerobot.core.conventions import GRASP_FRACTION, PALM_DOF


@dataclass(frozen=True)
class EpisodeMeta:
    """What an episode was: one value per episode, each a column of the dataset's episode table.

    Attributes:
        seed: the seed that determines everything drawn for the episode.
        split: the seed stream it belongs to (``train``, ``val``, ``test``, ``ood_*``), and digits of a salt's hash.
        motion: kind of motion, one of the 22 names.
        category: its category, one of the 8 names.
        object: the object's name, one of the 11.
        parameters: the motion's parameters, JSON with SI units, world frame.
        task: the instruction given to the policy.
        agent: who moved the hand (``intercept``, ``hold``, a policy's name; in an on-policy recording type and hash of
            its checkpoint, ``obact@...``).
        capture: the capture rule, ``attach``, ``attach_lenient`` or ``contact``.
        protocol: one of ``rules.PROTOCOLS``.
        control_class: limits of the hand and latency of its commands, ``unlimited``, ``standard`` or ``late``.
        window_frames: length of the observation window [frames].
        length_frames: L, the length of the expert's recording [frames]; a policy gets L control steps.
        intercept_frame: frame at which the oracle intercept takes place, counted from the episode's start.
        attempts: how many attempts the agent needed, from 1.
        fingerprint: identifies the code and recipe that made the episode.
        benchmark: version of the benchmark that the episode was drawn and played under.
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
    window_frames: int
    length_frames: int
    intercept_frame: int
    attempts: int
    fingerprint: str
    benchmark: str


@dataclass(frozen=True, eq=False)
class Episode:
    """One rollout of T frames at 20 Hz; frame t holds what was seen and what was then commanded.

    Home frame, SI units; `features.py` has shapes, units and names of all arrays. ``state[t]`` is measured at time
    t * 0.05 s, ``executed_action[t]`` is the command executed from then until frame t + 1. The window is frames
    ``[0, window_frames)``; control starts at frame ``window_frames``.

    Attributes:
        meta: one value per episode.
        images: (T, H, W, 3) uint8 RGB by view, ``ego`` (the hand's camera) first; empty if nothing was rendered.
        state: (T, 18) float32, palm centre position [m] and 15 joint angles [rad].
        fingertips: (T, 30) float32, 5 x (position [m], rotation vector [rad]), which follow from ``state``.
        phase: (T, 2) float32, [1, 0] observing, [0, 1] acting.
        action: (T, 18) float32, palm position [m] and joint angles [rad]. In recordings for learning the teacher's
            goal, which may lie beyond the reach of one frame, also in the window, where commands are void; elsewhere
            ``executed_action``. (T, 4) where the control mode is ``grasp``.
        executed_action: (T, 18) float32, the commands for the next frame that were executed, within the limits of the
            hand and with what perturbed them.
        target_pose: (T, 7) float32, position [m] and quaternion wxyz of the target.
        target_velocity: (T, 6) float32, linear [m/s] and angular [rad/s] velocity of the target.
        target_path: (F, 3) float32 [m], where the target would be in every frame had nothing touched it. F = window +
            L + 1, as long as an evaluation may last, so it extends beyond the end of a recorded catch.
        target_contacts: (T, 5) float32, 1 where the finger touches the target.
        palm_distance: (T,) float32 [m], palm centre to target centre, the least within the control step that ends
            at the frame (so a fast target cannot pass between two frames unseen).
        fingertip_distance: (T,) float32 [m], least distance of the five fingertips to the target's surface, 0 inside.
        localized: (T,) bool, the target is (or has been) localised and, under ``attach``, is welded to the hand.
        captured: (T,) bool, the capture rule regards the target as captured at this frame.
        intercept_position: (3,) float32 [m], the oracle intercept.
        intercept_time: the oracle intercept's time [s] from the episode's start.
        home_position: (3,) float32 [m], the home frame's origin, world.
        open_joints: (15,) float32 [rad], joint angles of the open hand.
        reference_joints: (15,) float32 [rad], joint angles of the reference grasp of this object.
        succeeded: (T,) bool, the frames up to the one that ``action[t]`` leads to make the episode a success.
        object_primitives: (S, 11) float32, the object's solids, see ``objects.primitives.as_table``.
        object_size: (3,) float32 [m], extent of the object along its own axes.
        object_mass: of the object [kg].
        object_inertia: (3,) float32 [kg m^2], its moments of inertia about its own axes.
        object_friction: (2,) float32, its sliding friction coefficients against the hand and against surfaces.
        object_restitution: rebound speed over impact speed of the impacts of its motion; 0 if it has none.
        ego_camera: (7,) float32, position [m] and quaternion wxyz of the hand's camera from the palm centre.
        side_camera: (7,) float32, likewise of the side camera, home frame.
        ego_intrinsics, side_intrinsics: (4,) float32 [px], focal lengths fx and fy, principal point cx and cy.
        hand_limits: (3,) float32, speed limits of palm [m/s] and joints [rad/s], latency [ms].
        first_plan: (2,) float32, planned speed [m/s] and lead time [s] at control start; 0 if the actor plans none.
        success: the capture rule's verdict on the whole episode.
        stage: how far it got: ``missed``, ``localized``, ``captured`` (rule ``attach``) or ``missed``, ``touched``,
            ``enclosed``, ``slipped``, ``held`` (rule ``contact``).
        touch: (T, 5) float32 [N], mean force of each finger on the target in the control step that ends at the frame;
            None unless the capture rule ``uses_contact_sensors``.
        sighting: (T, 14) float32 [m], where the eye saw the target; None unless the recipe's ``environment_state`` is
            ``eye``.
    """

    meta: EpisodeMeta
    images: dict[str, np.ndarray] = field(repr=False)
    state: np.ndarray = field(repr=False)
    fingertips: np.ndarray = field(repr=False)
    phase: np.ndarray = field(repr=False)
    action: np.ndarray = field(repr=False)
    executed_action: np.ndarray = field(repr=False)
    target_pose: np.ndarray = field(repr=False)
    target_velocity: np.ndarray = field(repr=False)
    target_path: np.ndarray = field(repr=False)
    target_contacts: np.ndarray = field(repr=False)
    palm_distance: np.ndarray = field(repr=False)
    fingertip_distance: np.ndarray = field(repr=False)
    localized: np.ndarray = field(repr=False)
    captured: np.ndarray = field(repr=False)
    intercept_position: np.ndarray = field(repr=False)
    intercept_time: float
    home_position: np.ndarray = field(repr=False)
    open_joints: np.ndarray = field(repr=False)
    reference_joints: np.ndarray = field(repr=False)
    succeeded: np.ndarray = field(repr=False)
    object_primitives: np.ndarray = field(repr=False)
    object_size: np.ndarray = field(repr=False)
    object_mass: float
    object_inertia: np.ndarray = field(repr=False)
    object_friction: np.ndarray = field(repr=False)
    object_restitution: float
    ego_camera: np.ndarray = field(repr=False)
    side_camera: np.ndarray = field(repr=False)
    ego_intrinsics: np.ndarray = field(repr=False)
    side_intrinsics: np.ndarray = field(repr=False)
    hand_limits: np.ndarray = field(repr=False)
    first_plan: np.ndarray = field(repr=False)
    success: bool
    stage: str
    touch: np.ndarray | None = field(default=None, repr=False)
    sighting: np.ndarray | None = field(default=None, repr=False)

    def __len__(self) -> int:
        """Return T, the number of frames."""
        return len(self.state)

    @property
    def control(self) -> slice:
        """Frames of the control phase."""
        return slice(self.meta.window_frames, len(self))

    @property
    def palm_pos_h(self) -> np.ndarray:
        """(T, 3) palm centre positions [m], home frame."""
        return self.state[:, :PALM_DOF]

    @property
    def joints(self) -> np.ndarray:
        """(T, 15) joint angles [rad]."""
        return self.state[:, PALM_DOF:]

    @property
    def environment_state(self) -> np.ndarray:
        """(T, 13) float32, ``target_pose`` and ``target_velocity``, which a dataset on request shows to policies."""
        return np.concatenate([self.target_pose, self.target_velocity], axis=1)

    @property
    def reward(self) -> np.ndarray:
        """(T,) float32, 1 where the action leads to the first frame on which the episode is a success, else 0."""
        return np.diff(self.succeeded, prepend=False).astype(np.float32)

    @property
    def done(self) -> np.ndarray:
        """(T,) bool, True for the last frame of the recording."""
        return np.arange(len(self)) == len(self) - 1

    @property
    def attempt_success(self) -> np.ndarray:
        """(attempts,) bool, whether each attempt succeeded: all but the last, which is recorded here, have failed."""
        return np.array([False] * (self.meta.attempts - 1) + [self.success])

    @property
    def first_localized(self) -> int | None:
        """The first localised frame of the control phase, or None (Section 5, "task completion")."""
        hits = np.flatnonzero(self.localized[self.control])
        return int(hits[0]) + self.meta.window_frames if hits.size else None


def joints_reached(joints: np.ndarray, open_joints: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Tell which joints turned in the reference's direction by at least 0.9 of its rotation.

    The pose criterion of Appendix "Evaluation Criteria". A joint that the reference leaves open counts as reached.

    Args:
        joints: (..., 15) joint angles [rad].
        open_joints: (15,) angles of the open hand [rad].
        reference: (15,) angles of the reference grasp [rad].

    Returns:
        (..., 15) bool.
    """
    rotation, wanted = joints - open_joints, reference - open_joints
    return rotation * np.sign(wanted) >= GRASP_FRACTION * np.abs(wanted) - 1e-6
