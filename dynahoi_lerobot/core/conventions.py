"""The numbers every part agrees on: clocks, units, thresholds, dimensions.

SI units, z up, quaternions wxyz, angles in radians. Positions end in ``_w`` in the world frame, in
which episodes are drawn and simulated, and in ``_h`` in the home frame, in which they are played
and recorded: axes of the world, origin where the palm's center waits in this episode.
"""

import math

CONTROL_HZ = 20
"""Control and frame rate [Hz] (Appendix "Data collection": ``sendInterval = 0.05 s``)."""

CONTROL_DT = 1.0 / CONTROL_HZ
"""Duration of one frame [s]."""

ROUNDING_FRAMES = 1e-9
"""By how much a time may exceed a whole number of frames, being computed in floating point."""


def frames_until(time_s: float) -> int:
    """Return the first frame at or after a time [s]: 150 ms are three frames."""
    return math.ceil(time_s / CONTROL_DT - ROUNDING_FRAMES)


PHYSICS_HZ = 500
"""Simulation rate [Hz]."""

PHYSICS_DT = 1.0 / PHYSICS_HZ
"""Duration of one physics step [s]."""

SUBSTEPS = PHYSICS_HZ // CONTROL_HZ
"""Physics steps per frame."""

UNIT_M = 0.1
"""One world unit (u) of the paper [m]."""

LOCALIZATION_RADIUS_M = 0.3 * UNIT_M
"""Palm center to object center, below which the target is localized [m] (Appendix "Evaluation
Criteria")."""

LENIENT_RADIUS_M = 1.0 * UNIT_M
"""The threshold the paper grants vision-language models [m] (Appendix "Evaluation Criteria")."""

GRASP_FRACTION = 0.9
"""Share of the reference rotation every joint must reach (Appendix "Evaluation Criteria")."""

LARGEST_GRASP_FRACTION = 1.2
"""Share of the reference rotation that no joint may exceed in a successful grasp; a fist does."""

PALM_DOF = 3
FINGERS = ("thumb", "index", "middle", "ring", "little")
JOINTS_PER_FINGER = 3
FINGER_DOF = len(FINGERS) * JOINTS_PER_FINGER
HAND_DOF = PALM_DOF + FINGER_DOF
"""3 palm translations and 15 flexion joints (Section 3.1)."""

EGO_VIEW = "ego"
"""The view of the camera that is fixed to the hand; the camera in the model has the same name."""

DEPTH, SEGMENTATION = "_depth", "_segmentation"
"""How the names of views end whose colors are measurements."""

DEFAULT_IMAGE_SIZE_PX = 128
"""Side of the square images where nothing is said [px]."""
DETECTOR_IMAGE_SIZE_PX = 96
"""Side of the images that the eye learned from, which ``environment_state=eye`` needs [px]."""

PALM_AXES = ("palm_x", "palm_y", "palm_z")
JOINT_NAMES = tuple(
    f"{finger}_{joint}" for finger in FINGERS for joint in ("base", "middle", "tip")
)
HAND_NAMES = (*PALM_AXES, *JOINT_NAMES)
"""Degrees of freedom by name, in the order of actions, states and actuators."""

FURNITURE_STREAM = 0xF0A1
SCREEN_STREAM = 0x5C4EE7
APPEARANCE_STREAM = 0xA99EA
DISTURBANCE_STREAM = 0xD157
RENDER_NOISE_STREAM = 0x0153
"""What begins the seeds of random numbers that an episode itself is not sampled from: it keeps them
all apart."""

SEED_LIMIT = 2**40
"""Episodes are numbered, within a split and a kind of motion, by whole numbers below this."""

INTERCEPT_SPEED_M_S = 0.3
"""The hand speed for which the intercept is the earliest reachable one [m/s]."""

WINDOW_FRACTION = 0.2
MIN_WINDOW_FRAMES = 8
"""The observation window is the first 20 % of the frames, at least this many."""

GANTRY_RANGE_M = ((-2.0, 2.0), (-2.0, 2.0), (0.02, 2.5))
"""Reach of the palm center along each axis [m], world."""

GANTRY_SPEED_M_S = 2.0
"""Greatest speed of each slide that carries the palm where hand and target collide [m/s]."""

TORSIONAL_FRICTION_M = 0.002
ROLLING_FRICTION_M = 0.0002
"""Torsional and rolling friction of contacts: greatest torque over normal force [m]."""
