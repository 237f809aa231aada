"""Who touches the target, and how hard: contact sensors in the scene, and reading them."""

from __future__ import annotations

import mujoco
import numpy as np

from dynahoi_lerobot.foundation.conventions import FINGERS
from dynahoi_lerobot.hands.base import PALM_BODY

TOUCHING = (*FINGERS, "palm", "elsewhere")
"""What is told apart: five fingers, the palm, and everything that is not the hand."""
PALM, ELSEWHERE = TOUCHING.index("palm"), TOUCHING.index("elsewhere")

FOUND, FORCE = 0, slice(1, 4)
SENSOR_SIZE = 4
NET_FORCE = 3
"""The reduction of a contact sensor that adds up all contacts it matches."""


def add_touch_sensors(spec: mujoco.MjSpec) -> None:
    """Add a contact sensor for each finger, for the palm, and for whatever touches the target."""
    body, subtree = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_XBODY
    for finger in FINGERS:
        _add_sensor(spec, f"touch_{finger}", f"{finger}_base", subtree)
    _add_sensor(spec, "touch_palm", PALM_BODY, body)
    _add_sensor(spec, "touch_any", "", mujoco.mjtObj.mjOBJ_UNKNOWN)


def read_touch(sensordata: np.ndarray) -> np.ndarray:
    """Return (..., 7) the net force of each of ``TOUCHING`` on the target [N]; of elsewhere, the number of contacts.

    Args:
        sensordata: (..., 28) of a scene with ``add_touch_sensors``.
    """
    sensors = sensordata.reshape(*sensordata.shape[:-1], len(TOUCHING), SENSOR_SIZE)
    touch = np.linalg.norm(sensors[..., FORCE], axis=-1)
    found = sensors[..., FOUND]
    touch[..., ELSEWHERE] = found[..., ELSEWHERE] - found[..., :ELSEWHERE].sum(axis=-1)
    return touch


def _add_sensor(spec: mujoco.MjSpec, name: str, other: str, kind: mujoco.mjtObj) -> None:
    sensor = spec.add_sensor(
        name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_BODY, objname="target"
    )
    if other:
        sensor.reftype, sensor.refname = kind, other
    fields = mujoco.mjtConDataField.mjCONDATA_FOUND, mujoco.mjtConDataField.mjCONDATA_FORCE
    sensor.intprm[:3] = (sum(1 << field.value for field in fields), NET_FORCE, 1)
