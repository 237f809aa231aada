"""The force that keeps a target on its path: discrete inverse dynamics, exact at every physics step.

A prescribed target is an ordinary free body under an applied force. Semi-implicit Euler advances
v' = v + h (F / m + g), x' = x + h v', so F = m ((x'' - 2 x' + x) / h^2 - g) reproduces the path to rounding error. To
let go of the target is to stop applying the force: no jump in position or velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.foundation.conventions import PHYSICS_DT, SUBSTEPS
from dynahoi_lerobot.motions import Motion, PrescribedMotion
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.objects import TargetObject

GRAVITY_W = np.array([0.0, 0.0, -GRAVITY_M_S2])


@dataclass(frozen=True, eq=False)
class TargetDrive:
    """The drive of one target.

    Attributes:
        start_pos_w: (3,) position at t = 0 [m].
        start_velocity_w: (3,) velocity at t = 0 [m/s].
        force_w: (F, 25, 3) applied force [N] in every physics step of every frame; zero where the target is
            free, apart from the impulse that releases it.
    """

    start_pos_w: np.ndarray
    start_velocity_w: np.ndarray
    force_w: np.ndarray


def drive_for(motion: Motion, target: TargetObject, frames: int) -> TargetDrive:
    """Return the drive that makes ``target`` perform ``motion`` for ``frames`` frames."""
    if isinstance(motion, PrescribedMotion):
        times = np.arange(-1, frames * SUBSTEPS + 1) * PHYSICS_DT
        return _follow(motion.position(times), target.mass_kg, frames)
    launch = motion.launch(target)
    start, velocity = np.asarray(launch.pos), np.asarray(launch.velocity)
    held = min(round(launch.release_s / PHYSICS_DT), frames * SUBSTEPS)
    if held == 0:
        return TargetDrive(start, velocity, np.zeros((frames, SUBSTEPS, 3)))
    force = np.zeros((frames * SUBSTEPS, 3))
    force[:held] = -target.mass_kg * GRAVITY_W
    force[held : held + 1] = target.mass_kg * velocity / PHYSICS_DT  # the impulse of letting go, in the first free step
    return TargetDrive(start, np.zeros(3), force.reshape(frames, SUBSTEPS, 3))


def _follow(path: np.ndarray, mass_kg: float, frames: int) -> TargetDrive:
    """Drive along ``path``, (frames * 25 + 2, 3) positions from one physics step before the start."""
    velocity = np.diff(path, axis=0) / PHYSICS_DT
    force = mass_kg * (np.diff(velocity, axis=0) / PHYSICS_DT - GRAVITY_W)
    return TargetDrive(path[1], velocity[0], force.reshape(frames, SUBSTEPS, 3))
