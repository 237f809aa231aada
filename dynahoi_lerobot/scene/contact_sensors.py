"""Contact sensors on the target, and how to read them."""

from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGERS
from dynahoi_lerobot.hands.base import PALM_BODY

N_SENSORS = len(FINGERS) + 2
"""One per finger, one for the palm, one for all contacts of the target."""
PALM = len(FINGERS)
ANY = len(FINGERS) + 1
FOUND = 0
FORCE = slice(1, 4)
SENSOR_SIZE = 4
NET_FORCE = 3
"""The reduction of a MuJoCo contact sensor that adds up all contacts it matches."""


@dataclass(frozen=True, eq=False)
class TargetContacts:
    """Contacts of the target, for worlds, frames or physics steps of shape (...).

    Attributes:
        finger_force_n: (..., 5) magnitude of the net force of each finger on the target [N].
        palm_force_n: (...) magnitude of the net force of the palm on the target [N].
        others: (...) number of contacts with anything but fingers and palm.
    """

    finger_force_n: np.ndarray
    palm_force_n: np.ndarray
    others: np.ndarray

    def __getitem__(self, part: slice) -> Self:
        """Return the contacts of some rows of the first axis."""
        return type(self)(self.finger_force_n[part], self.palm_force_n[part], self.others[part])

    @property
    def by_hand(self) -> np.ndarray:
        """(...) bool, a finger or the palm touches the target."""
        return (self.finger_force_n > 0).any(axis=-1) | (self.palm_force_n > 0)


def no_contacts(*shape: int) -> TargetContacts:
    """Return contacts of ``shape`` without any touch."""
    return TargetContacts(np.zeros((*shape, len(FINGERS))), np.zeros(shape), np.zeros(shape))


def read_contacts(sensordata: np.ndarray) -> TargetContacts:
    """Return the contacts of the target.

    Args:
        sensordata: (..., 28) of a scene with ``add_contact_sensors``.
    """
    sensors = sensordata.reshape(*sensordata.shape[:-1], N_SENSORS, SENSOR_SIZE)
    force = np.linalg.norm(sensors[..., FORCE], axis=-1)  # (..., 7)
    found = sensors[..., FOUND]
    return TargetContacts(
        force[..., :PALM], force[..., PALM], found[..., ANY] - found[..., :ANY].sum(axis=-1)
    )


def add_contact_sensors(spec: mujoco.MjSpec) -> None:
    """Add the sensors that ``read_contacts`` reads, in its order."""
    body = mujoco.mjtObj.mjOBJ_BODY
    subtree = mujoco.mjtObj.mjOBJ_XBODY
    for finger in FINGERS:
        _add_sensor(spec, f"touch_{finger}", f"{finger}_base", subtree)
    _add_sensor(spec, "touch_palm", PALM_BODY, body)
    _add_sensor(spec, "touch_any", "", mujoco.mjtObj.mjOBJ_UNKNOWN)


def _add_sensor(spec: mujoco.MjSpec, name: str, other: str, kind: mujoco.mjtObj) -> None:
    sensor = spec.add_sensor(
        name=name,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        objname="target",
    )
    if other:
        sensor.reftype = kind
        sensor.refname = other
    fields = mujoco.mjtConDataField.mjCONDATA_FOUND, mujoco.mjtConDataField.mjCONDATA_FORCE
    sensor.intprm[:3] = (sum(1 << field.value for field in fields), NET_FORCE, 1)
