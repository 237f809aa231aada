"""The target keeps to its path: prescribed ones to the closed form, all of them to the untouched
one.
"""

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT, PHYSICS_DT, SUBSTEPS
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.motions import MOTIONS, PrescribedMotion
from dynahoi_lerobot.scene.world_fields import GRAVITY_W
from tests.simulation import draw_motion, simulate
from tests.world.playing import world

PRESCRIBED = [name for name, kind in MOTIONS.items() if issubclass(kind, PrescribedMotion)]
EXACT_M = 1e-9


@pytest.mark.parametrize("kind", PRESCRIBED)
def test_a_driven_target_is_on_its_closed_form_at_every_physics_step(kind: str):
    drawn = draw_motion(kind, 3)
    motion = drawn.motion
    track = simulate(motion, drawn.target, 1.0)
    np.testing.assert_allclose(track.pos, motion.position(track.time), atol=EXACT_M)
    change = motion.position(track.time) - motion.position(track.time - PHYSICS_DT)
    np.testing.assert_allclose(track.velocity[1:], change[1:] / PHYSICS_DT, atol=1e-3)


@pytest.mark.parametrize("kind", PRESCRIBED)
def test_letting_go_is_continuous_in_position_and_velocity(kind: str):
    """From the step at which the force stops, gravity alone changes the velocity: no impulse."""
    drawn = draw_motion(kind, 3)
    released = 10 * SUBSTEPS
    track = simulate(drawn.motion, drawn.target, 0.6, driven_frames=10)
    position = track.pos[released:]
    velocity = track.velocity[released:]
    change = np.diff(velocity, axis=0)
    np.testing.assert_allclose(change, np.tile(GRAVITY_W * PHYSICS_DT, (len(change), 1)), atol=1e-9)
    np.testing.assert_allclose(np.diff(position, axis=0), velocity[1:] * PHYSICS_DT, atol=1e-12)


def test_a_prescribed_target_spins_steadily_and_keeps_its_velocity_in_the_world_frame(
    specs: list[EpisodeSpec],
):
    spec = next(s for s in specs if s.motion.name == "lateral")
    batch = world([spec])
    for _ in range(spec.window_frames):
        np.testing.assert_allclose(
            batch.target_velocity_w[0, 3:], [0.0, 0.0, spec.spin_rad_s], atol=1e-6
        )
        batch.step(batch.executed)
    turned = spec.yaw_rad + spec.spin_rad_s * spec.window_frames * CONTROL_DT
    half = np.array([np.cos(turned / 2), np.sin(turned / 2)])
    assert abs(batch.target_pose_h[0, [3, 6]] @ half) == pytest.approx(1.0, abs=1e-6)
    last, now = spec.motion.position(spec.window_frames * CONTROL_DT + np.array([-PHYSICS_DT, 0.0]))
    np.testing.assert_allclose(batch.target_velocity_w[0, :3], (now - last) / PHYSICS_DT, atol=1e-6)


def test_the_angular_velocity_is_given_in_the_world_frame(specs: list[EpisodeSpec]):
    """A rolling target turns about the horizontal across its slope, whatever its own axes do: w = n
    x v / r.
    """
    spec = next(s for s in specs if s.motion.name == "ramp")
    batch = world([spec])
    _, normal = spec.motion.slope_axes()
    while batch.frame[0] < spec.intercept_frame - 1:
        batch.step(batch.executed)
    linear = batch.target_velocity_w[0, :3]
    angular = batch.target_velocity_w[0, 3:]
    assert np.linalg.norm(linear) > 0.1
    expected = np.cross(normal, linear) / spec.target.roll_radius_m
    np.testing.assert_allclose(angular, expected, atol=0.05 * np.linalg.norm(expected))
