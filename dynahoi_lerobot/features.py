"""The one feature table: gymnasium spaces, LeRobot env features and dataset features are read from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynahoi_lerobot.foundation.conventions import FINGERS, HAND_DOF, HAND_NAMES

FINGERTIP_NAMES = tuple(
    f"{finger}_{part}" for finger in FINGERS for part in ("x", "y", "z", "rotvec_x", "rotvec_y", "rotvec_z")
)
POSE_NAMES = ("x", "y", "z", "qw", "qx", "qy", "qz")
TWIST_NAMES = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True)
class Feature:
    """One column: its key, shape, element type, the names of its elements and its unit."""

    key: str
    shape: tuple[int, ...]
    dtype: str
    names: tuple[str, ...]
    unit: str
    privileged: bool = False


STATE = Feature("observation.state", (HAND_DOF,), "float32", HAND_NAMES, "m, rad")
FINGERTIPS = Feature("observation.fingertips", (6 * len(FINGERS),), "float32", FINGERTIP_NAMES, "m, rad")
TOUCH = Feature("observation.touch", (len(FINGERS),), "float32", FINGERS, "N")
"""Only where the capture rule uses_contact_sensors."""
PHASE = Feature("observation.phase", (1,), "float32", ("phase",), "0 observing, 1 acting")
ACTION = Feature("action", (HAND_DOF,), "float32", HAND_NAMES, "m, rad")
PICTURE_PREFIX = "observation.images."
CAMERA_KEY = PICTURE_PREFIX + "ego"

PRIVILEGED = (
    Feature("target.pose", (7,), "float32", POSE_NAMES, "m, quaternion wxyz", True),
    Feature("target.velocity", (6,), "float32", TWIST_NAMES, "m/s, rad/s", True),
    Feature("target.contacts", (len(FINGERS),), "float32", FINGERS, "1 touching", True),
    Feature("intercept.position", (3,), "float32", ("x", "y", "z"), "m", True),
    Feature("intercept.time", (1,), "float32", ("time",), "s", True),
    Feature("localized", (1,), "bool", ("localized",), "flag", True),
    Feature("captured", (1,), "bool", ("captured",), "flag", True),
)
"""Never named ``observation.*``, so that no policy can see them."""

OBSERVATIONS = (STATE, FINGERTIPS, PHASE)

__all__ = [
    "ACTION",
    "CAMERA_KEY",
    "FINGERTIPS",
    "OBSERVATIONS",
    "PHASE",
    "PICTURE_PREFIX",
    "PRIVILEGED",
    "STATE",
    "TOUCH",
    "Feature",
]


def picture_feature(image_size: int, view: str = "ego") -> Feature:
    """Return a view's column for square images of ``image_size`` pixels, HWC RGB."""
    names = ("height", "width", "channels")
    return Feature(PICTURE_PREFIX + view, (image_size, image_size, 3), "uint8", names, "RGB 0-255")


def columns(image_size: int | None, views: Sequence[str] = (), *, touch: bool = False) -> tuple[Feature, ...]:
    """Return every per-frame column in the dataset's order.

    Args:
        image_size: side of the pictures [pixels]; None leaves all of them out.
        views: pictures besides the hand's camera.
        touch: whether the capture rule uses_contact_sensors.
    """
    pictures = () if image_size is None else tuple(picture_feature(image_size, view) for view in ("ego", *views))
    return (*pictures, *OBSERVATIONS, *((TOUCH,) if touch else ()), ACTION, *PRIVILEGED)
