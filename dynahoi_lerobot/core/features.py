"""The one feature table: every array of an episode, and its name in each interface.

Positions are in the home frame: axes of the world (z up, the open palm faces +x), origin where the
palm's center waits in this episode. Rotations and velocities are along the same axes.

From ``FEATURES`` are derived the Gymnasium spaces (`env/vector_env.py`), the features of
``--env.type=dynahoi``, what a rollout records (`rollout/recorder.py`), the dataset's columns and
reader (`dataset/columns.py`) and the documentation (``dynahoi list features``). A new feature is
one entry here, an attribute of that name in ``Episode`` (and in ``Observation`` where policies may
see it), and what computes it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.control_mode import CONTROL_MODES, GRASP, JOINTS
from dynahoi_lerobot.core.conventions import (
    DEPTH,
    EGO_VIEW,
    FINGER_DOF,
    FINGERS,
    HAND_DOF,
    HAND_NAMES,
    JOINT_NAMES,
    SEGMENTATION,
)
from dynahoi_lerobot.core.protocols import PHASES

OBSERVATION_PREFIX = "observation."
"""LeRobot gives policies the columns of this prefix, and no others."""
IMAGE_PREFIX = OBSERVATION_PREFIX + "images."


@dataclass(frozen=True)
class Feature:
    """One array of an episode.

    Attributes:
        name: attribute of ``Episode``, and of ``Observation`` if policies may see it.
        key: column of the dataset.
        shape: of one frame, () for a number, which the dataset stores as (1,). What policies see
            has two elements or more, because LeRobot cannot stream windows over one.
        names: of the elements, in order.
        unit: of the elements.
        meaning: a description with the frame of reference.
        dtype: element type in ``Episode`` and in the dataset.
        gym_key: key in the Gymnasium observation (``group/key`` if nested); None for privileged
            features.
        low: least value in the Gymnasium space, in ``unit``; values beyond are clipped.
        high: greatest value, likewise.
        needs_contact_sensors: whether only capture rules with ``uses_contact_sensors`` have it.
        on_request: whether policies and datasets get it only if the rules' ``environment_state``
            asks for it.
        privileged: whether no policy may read it, only metrics and teachers: the dataset then
            stores it in the privileged tables, which LeRobot does not read.
        per: what it has a row for: ``frame``, ``episode``, or something of which episodes have
            different numbers, as ``attempt``, ``primitive`` or ``path frame``.
        derived: whether it follows from other attributes: a property of ``Episode``, which is
            stored but not read.
    """

    name: str
    key: str
    shape: tuple[int, ...]
    names: tuple[str, ...]
    unit: str
    meaning: str
    dtype: str = "float32"
    gym_key: str | None = None
    low: float = -math.inf
    high: float = math.inf
    needs_contact_sensors: bool = False
    on_request: bool = False
    privileged: bool = False
    per: str = "frame"
    derived: bool = False

    @property
    def column_shape(self) -> tuple[int, ...]:
        """Shape of one row of the column."""
        return self.shape or (1,)

    @property
    def observed(self) -> bool:
        """Whether policies see it."""
        return self.key.startswith(OBSERVATION_PREFIX)

    @property
    def rules_decide(self) -> bool:
        """Whether only the rules tell if a dataset has it, since every episode does."""
        return self.on_request and self.derived

    @property
    def is_image(self) -> bool:
        """Whether it is the images of a view."""
        return self.key.startswith(IMAGE_PREFIX)

    @property
    def measures(self) -> bool:
        """Whether it is images whose colors are measurements, which no video may change: with the
        default settings, h264 moves depth by up to 34 cm and gives 11 % of the target's pixels the
        color of something else (22 episodes, 96 px).
        """
        return self.is_image and self.key.endswith((DEPTH, SEGMENTATION))

    @property
    def is_ragged(self) -> bool:
        """Whether its number of rows is neither that of the frames nor one per episode."""
        return self.per not in ("frame", "episode")


FINGERTIP_NAMES = tuple(
    f"{finger}_{part}"
    for finger in FINGERS
    for part in ("x", "y", "z", "rotvec_x", "rotvec_y", "rotvec_z")
)
COMMAND_NAMES = tuple(f"{name}.pos" for name in HAND_NAMES)
"""LeRobot's robots and teleoperators tell positions by this suffix."""
POSITION_NAMES = ("x", "y", "z")
POSE_NAMES = (*POSITION_NAMES, "qw", "qx", "qy", "qz")
TWIST_NAMES = ("vx", "vy", "vz", "wx", "wy", "wz")
PRIMITIVE_NAMES = ("geom_type", "size_x", "size_y", "size_z", *POSE_NAMES)
INTRINSICS_NAMES = ("fx", "fy", "cx", "cy")

CAMERA_KEY = IMAGE_PREFIX + EGO_VIEW
PIXELS = "pixels"
"""Key of the dictionary of images in a Gymnasium observation, as LeRobot expects it."""
ENVIRONMENT_STATE = "observation.environment_state"
"""LeRobot's name for what policies read of the environment besides images."""
TRUTH = "truth"
EYE = "eye"
ENVIRONMENT_STATES = {"": "", TRUTH: "environment_state", EYE: "sighting"}
"""What it may be, by value of the rules' ``environment_state``: the name of a feature."""
SIGHTING_AGES = (0, 2, 4, 8)
"""Ages of the positions in a sighting [frames]."""
SIGHTING_NAMES = (
    *(f"{axis}_{age}" for age in SIGHTING_AGES for axis in ("x", "y", "z")),
    "log_error_across",
    "log_error_along",
)

_TABLE = (
    Feature(
        "state",
        "observation.state",
        (HAND_DOF,),
        COMMAND_NAMES,
        "m, rad",
        "palm center position, home frame; joint angles",
        gym_key="agent_pos",
        low=-10.0,
        high=10.0,
    ),
    Feature(
        "fingertips",
        "fingertips",
        (6 * len(FINGERS),),
        FINGERTIP_NAMES,
        "m, rad",
        "position, home frame, and rotation vector of each fingertip; computable from the state",
        privileged=True,
    ),
    Feature(
        "phase",
        "observation.phase",
        (len(PHASES),),
        PHASES,
        "1",
        "[1, 0] in the observation window, [0, 1] in the control phase",
        gym_key="phase",
        low=0.0,
        high=1.0,
    ),
    Feature(
        "touch",
        "observation.touch",
        (len(FINGERS),),
        FINGERS,
        "N",
        "force of each finger on the target, averaged over the last control step",
        gym_key="touch",
        low=0.0,
        high=1000.0,
        needs_contact_sensors=True,
    ),
    Feature(
        "environment_state",
        ENVIRONMENT_STATE,
        (13,),
        (*POSE_NAMES, *TWIST_NAMES),
        "m, 1, m/s, rad/s",
        "true state of the target: position, home frame, and quaternion wxyz, as target.pose; "
        "linear and angular velocity, world axes, as target.velocity",
        gym_key="environment_state",
        low=-1000.0,
        high=1000.0,
        on_request=True,
        derived=True,
    ),
    Feature(
        "sighting",
        ENVIRONMENT_STATE,
        (len(SIGHTING_NAMES),),
        SIGHTING_NAMES,
        "m, 1",
        "where the eye, a pretrained image encoder, sees the target from the hand's camera, home "
        "frame, now and 2, 4 "
        "and 8 frames ago; natural logarithms of its expected error now across and along the "
        "line of sight, as shares "
        "of the distance",
        gym_key="environment_state",
        low=-1000.0,
        high=1000.0,
        on_request=True,
    ),
    Feature(
        "action",
        "action",
        (HAND_DOF,),
        COMMAND_NAMES,
        "m, rad",
        "goal pose: palm center position, home frame, possibly farther than the hand can move in "
        "one frame, since the "
        "environment clips it; joint angles for the next frame. In datasets the expert's goal, "
        "also in the observation "
        "window, where commands are ignored",
        gym_key="action",
    ),
    Feature(
        "given_action",
        "given_action",
        (HAND_DOF,),
        COMMAND_NAMES,
        "m, rad",
        "command given in this frame by expert or policy, after disturbance, within reach when "
        "it takes effect",
        privileged=True,
    ),
    Feature(
        "executed_action",
        "executed_action",
        (HAND_DOF,),
        COMMAND_NAMES,
        "m, rad",
        "command that the hand executes from this frame to the next, after limits, latency and "
        "disturbance",
        privileged=True,
    ),
    Feature(
        "target_pose_h",
        "target.pose",
        (7,),
        POSE_NAMES,
        "m, 1",
        "target position, home frame, and quaternion wxyz",
        privileged=True,
    ),
    Feature(
        "target_velocity_w",
        "target.velocity",
        (6,),
        TWIST_NAMES,
        "m/s, rad/s",
        "target linear and angular velocity, world axes",
        privileged=True,
    ),
    Feature(
        "target_path_h",
        "target_path",
        (3,),
        POSITION_NAMES,
        "m",
        "undisturbed position of the target, home frame, in every frame of a full-length "
        "evaluation",
        per="path frame",
        privileged=True,
    ),
    Feature(
        "target_contacts",
        "target.contacts",
        (len(FINGERS),),
        FINGERS,
        "1",
        "1 if the finger touches the target",
        privileged=True,
    ),
    Feature(
        "intercept_pos_h",
        "intercept.position",
        (3,),
        POSITION_NAMES,
        "m",
        "oracle intercept, home frame",
        per="episode",
        privileged=True,
    ),
    Feature(
        "intercept_s",
        "intercept.time",
        (),
        ("time",),
        "s",
        "time of the oracle intercept from the start of the episode",
        per="episode",
        privileged=True,
    ),
    Feature(
        "localized",
        "localized",
        (),
        ("localized",),
        "1",
        "the target is or was localized",
        dtype="bool",
        privileged=True,
    ),
    Feature(
        "captured",
        "captured",
        (),
        ("captured",),
        "1",
        "the target is captured by the capture rule",
        dtype="bool",
        privileged=True,
    ),
    Feature(
        "reward",
        "next.reward",
        (),
        ("reward",),
        "1",
        "the environment's dense reward: 1 if the action led to the first successful frame, and in "
        "the control phase how much closer palm and target have come, and how much better the "
        "hand is closed near the target",
        derived=True,
    ),
    Feature(
        "done",
        "next.done",
        (),
        ("done",),
        "1",
        "last frame of the recording",
        dtype="bool",
        derived=True,
    ),
    Feature(
        "succeeded",
        "next.success",
        (),
        ("success",),
        "1",
        "the episode is a success by the frame the action led to",
        dtype="bool",
    ),
    Feature(
        "palm_distance_m",
        "palm_distance",
        (),
        ("distance",),
        "m",
        "least distance of palm center and target center in the last control step",
        privileged=True,
    ),
    Feature(
        "fingertip_distance_m",
        "fingertip_distance",
        (),
        ("distance",),
        "m",
        "least distance of a fingertip to the target's surface, 0 inside",
        privileged=True,
    ),
    Feature(
        "home_pos_w",
        "home_position",
        (3,),
        POSITION_NAMES,
        "m",
        "origin of the home frame, world; the floor is at z = 0",
        per="episode",
        privileged=True,
    ),
    Feature(
        "open_joints",
        "open_joints",
        (FINGER_DOF,),
        JOINT_NAMES,
        "rad",
        "joint angles of the open hand",
        per="episode",
        privileged=True,
    ),
    Feature(
        "reference_joints",
        "reference_joints",
        (FINGER_DOF,),
        JOINT_NAMES,
        "rad",
        "joint angles of the object's reference grasp",
        per="episode",
        privileged=True,
    ),
    Feature(
        "object_primitives",
        "object_primitives",
        (len(PRIMITIVE_NAMES),),
        PRIMITIVE_NAMES,
        "1, m",
        "the object's solids: MuJoCo's geom type and half-sizes; position and quaternion wxyz in "
        "the object's frame, "
        "whose origin is the center of mass",
        per="primitive",
        privileged=True,
    ),
    Feature(
        "object_size",
        "object_size",
        (3,),
        POSITION_NAMES,
        "m",
        "extent of the object along its own axes",
        per="episode",
        privileged=True,
    ),
    Feature(
        "object_mass_kg",
        "object_mass",
        (),
        ("mass",),
        "kg",
        "mass of the object",
        privileged=True,
        per="episode",
    ),
    Feature(
        "object_inertia",
        "object_inertia",
        (3,),
        POSITION_NAMES,
        "kg m^2",
        "moments of inertia of the object about its own axes",
        per="episode",
        privileged=True,
    ),
    Feature(
        "object_friction",
        "object_friction",
        (2,),
        ("hand", "surface"),
        "1",
        "sliding friction coefficients of the object against the hand and against the roughest "
        "surface it meets",
        per="episode",
        privileged=True,
    ),
    Feature(
        "object_restitution",
        "object_restitution",
        (),
        ("restitution",),
        "1",
        "ratio of rebound to impact speed in its motion; 0 without impacts",
        per="episode",
        privileged=True,
    ),
    Feature(
        "ego_camera_pose_palm",
        "ego_camera",
        (7,),
        POSE_NAMES,
        "m, 1",
        "pose of the hand's camera relative to the palm center; it looks along -z, y is up",
        per="episode",
        privileged=True,
    ),
    Feature(
        "side_camera_pose_h",
        "side_camera",
        (7,),
        POSE_NAMES,
        "m, 1",
        "pose of the side camera, home frame, same convention",
        per="episode",
        privileged=True,
    ),
    Feature(
        "ego_intrinsics",
        "ego_intrinsics",
        (4,),
        INTRINSICS_NAMES,
        "px",
        "focal lengths and principal point of the hand's camera",
        per="episode",
        privileged=True,
    ),
    Feature(
        "side_intrinsics",
        "side_intrinsics",
        (4,),
        INTRINSICS_NAMES,
        "px",
        "focal lengths and principal point of the side camera",
        per="episode",
        privileged=True,
    ),
    Feature(
        "hand_limits",
        "hand_limits",
        (3,),
        ("palm_speed", "joint_speed", "latency"),
        "m/s, rad/s, ms",
        "maximum speed of the palm (under contact, per axis) and of a joint; command latency",
        per="episode",
        privileged=True,
    ),
    Feature(
        "first_plan",
        "first_plan",
        (2,),
        ("speed", "lead_time"),
        "m/s, s",
        "the expert's plan at control start: mean palm speed to the meeting with the target, and "
        "time to it; 0 for "
        "actors without a plan",
        per="episode",
        privileged=True,
    ),
    Feature(
        "attempt_success",
        "attempt_success",
        (),
        ("success",),
        "1",
        "whether each attempt at the episode succeeded; the last one is recorded",
        dtype="bool",
        per="attempt",
        derived=True,
        privileged=True,
    ),
)

FEATURES = {feature.name: feature for feature in _TABLE}
"""By attribute name, in the dataset's order. Images depend on resolution and views: see
``image_feature``."""


def image_feature(view: str, image_size: int) -> Feature:
    """Return the feature of a view's images: square RGB, height x width x channel, 0-255."""
    return Feature(
        "images",
        IMAGE_PREFIX + view,
        (image_size, image_size, 3),
        ("height", "width", "channels"),
        "1",
        f"RGB image of view {view}",
        dtype="uint8",
        gym_key=f"{PIXELS}/{view}",
        low=0,
        high=255,
    )


def action_feature(control_mode: str) -> Feature:
    """Return the feature of the actions of a control mode."""
    feature = FEATURES["action"]
    if control_mode == JOINTS:
        return feature
    meaning = (
        "displacement from the palm's current position to the goal of control mode joints, "
        "along the axes of the home frame; closure of the hand, 0 (open) to 1"
    )
    names = CONTROL_MODES[control_mode]
    return replace(feature, shape=(len(names),), names=names, unit="m, 1", meaning=meaning)


TOLD_APART = (*FEATURES.values(), action_feature(GRASP))
"""Every feature but images. Two share the key ``action``, two ``ENVIRONMENT_STATE``: their
elements' names differ."""


def frame_features(
    image_size: int,
    views: Sequence[str] = (),
    *,
    control_mode: str = JOINTS,
    contact_sensors: bool = False,
    environment_state: str = "",
) -> tuple[Feature, ...]:
    """Return the columns of the frame table, in the dataset's order.

    Args:
        image_size: side of the images [px]; 0 for no camera.
        views: the views besides ``ego``.
        control_mode: one of ``CONTROL_MODES``.
        contact_sensors: whether the capture rule ``uses_contact_sensors``.
        environment_state: one of ``ENVIRONMENT_STATES``.
    """
    images = tuple(image_feature(view, image_size) for view in (EGO_VIEW, *views) if image_size)
    sensed = (f for f in FEATURES.values() if contact_sensors or not f.needs_contact_sensors)
    asked = (
        f for f in sensed if not f.on_request or f.name == ENVIRONMENT_STATES[environment_state]
    )
    stored = (feature for feature in asked if not feature.privileged)
    return (
        *images,
        *(
            action_feature(control_mode) if feature.name == "action" else feature
            for feature in stored
        ),
    )


def privileged_features() -> tuple[Feature, ...]:
    """Return the columns of the privileged tables: metrics and teachers need them, policies must
    not see them.
    """
    return tuple(feature for feature in FEATURES.values() if feature.privileged)


def as_gym(observation: Observation) -> dict[str, Any]:
    """Return an Observation under the keys of the Gymnasium space, (N, ...) each, clipped to its
    bounds.
    """
    entries: dict[str, Any] = {PIXELS: observation.images} if observation.images else {}
    for feature in FEATURES.values():
        if feature.observed and feature.gym_key is not None:
            value = getattr(observation, feature.name)
            if value is not None:
                entries[feature.gym_key] = np.clip(value, feature.low, feature.high)
    return entries
