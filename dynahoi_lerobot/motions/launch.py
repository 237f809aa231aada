"""How a target starts: position, velocity, release, and the fixtures around it."""

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import PHYSICS_DT
from dynahoi_lerobot.core.numerics import cos, sin

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""wxyz."""


def as_vector(values: np.ndarray) -> Vector:
    """Return a (3,) array as three plain floats."""
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def heading(yaw: float, pitch: float = 0.0) -> Vector:
    """Return the unit vector at ``yaw`` from +x towards +y and ``pitch`` above the horizontal
    [rad], world.
    """
    flat = cos(pitch)
    return (float(cos(yaw) * flat), float(sin(yaw) * flat), float(sin(pitch)))


def yaw_quat(yaw: float) -> Quaternion:
    """Return the rotation by ``yaw`` [rad] about z, wxyz."""
    return (float(cos(yaw / 2)), 0.0, 0.0, float(sin(yaw / 2)))


def yaw_pitch_quat(yaw: float, pitch: float) -> Quaternion:
    """Return the rotation that turns +x to ``yaw`` and to ``pitch`` below the horizontal [rad],
    wxyz.
    """
    cy = cos(yaw / 2)
    sy = sin(yaw / 2)
    cp = cos(pitch / 2)
    sp = sin(pitch / 2)
    return (float(cy * cp), float(-sy * sp), float(cy * sp), float(sy * cp))


GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Box:
    """A static box.

    Attributes:
        pos: center [m], world.
        half_size: half extents along its own axes [m].
        quat: orientation wxyz, world.
        restitution: of its contacts with the target, unless the target's own is greater.
        friction: sliding friction coefficient of these contacts, unless the target's own is
            greater.
    """

    pos: Vector
    half_size: Vector
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)
    restitution: float = 0.0
    friction: float = 0.0


@dataclass(frozen=True)
class Striker:
    """A ball without weight that flies in a straight line and hits the target.

    Attributes:
        pos: center at the start [m], world.
        velocity: constant until it hits [m/s], world, horizontal.
        radius_m: its radius.
        mass_kg: its mass.
        restitution: of its impact on the target, unless the target's own is greater.
    """

    pos: Vector
    velocity: Vector
    radius_m: float
    mass_kg: float
    restitution: float


@dataclass(frozen=True)
class Launch:
    """The initial condition of a physical motion, and the fixtures around it.

    Attributes:
        pos: center of the target [m], world.
        quat: its orientation wxyz, world.
        velocity: of its center [m/s], world.
        spin: its angular velocity [rad/s], target frame.
        release_s: the target is held still at ``pos`` until this time [s], and leaves with
            ``velocity``.
        boxes: up to two static boxes.
        tether: where the string on which it hangs is fixed, massless, rigid and as long as it must
            be [m], world.
        striker: the ball that hits it, if any.
        restitution: of its contacts with anything but the hand, rebound speed over impact speed, 0
            to 1.
        friction: sliding friction coefficient against surfaces; None for the object's own.
        drag_kg_s: linear drag on its center [N s/m].
    """

    pos: Vector
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    spin: Vector = (0.0, 0.0, 0.0)
    release_s: float = 0.0
    boxes: tuple[Box, ...] = ()
    tether: Vector | None = None
    striker: Striker | None = None
    restitution: float = 0.0
    friction: float | None = None
    drag_kg_s: float = 0.0


def ballistic_velocity(velocity: Vector) -> Vector:
    """Return the initial velocity [m/s] that puts a simulated flight on the parabola that starts
    with ``velocity``.

    Semi-implicit Euler, started with v, is at x + v t - g t^2 / 2 - g h t / 2 at every step: it
    falls ahead of the parabola, by what g h / 2 of initial velocity makes up for.
    """
    x, y, z = velocity
    return (x, y, z + GRAVITY_M_S2 * PHYSICS_DT / 2)
