"""What can be measured of N worlds, what a policy sees of them and what an expert does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynahoi_lerobot.agent import Observation, WorldState
from dynahoi_lerobot.captures.base import CaptureRule
from dynahoi_lerobot.control_class import ControlClass
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import PALM_DOF
from dynahoi_lerobot.phase import one_hot_phase
from dynahoi_lerobot.protocol import protocol_of
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.scene.scene import Scene
from dynahoi_lerobot.scene.servo import Servo
from dynahoi_lerobot.scene.world_fields import WorldFields
from dynahoi_lerobot.world.cameras import Cameras
from dynahoi_lerobot.world.fingertips import Fingertips
from dynahoi_lerobot.world.latency import CommandLatency
from dynahoi_lerobot.world.physics import Physics
from dynahoi_lerobot.world.target import Targets

TOUCH_M = 0.005
"""A fingertip this close touches the target: the sphere-overlap test of Appendix "Data collection"."""


class ObservedWorlds:
    """The half of a `WorldBatch` that changes nothing; attributes and frames are described there."""

    size: int
    scene: Scene
    rule: CaptureRule
    cameras: Cameras
    control: ControlClass
    servo: Servo
    specs: list[EpisodeSpec | None]
    frame: np.ndarray
    attempt: np.ndarray
    executed: np.ndarray
    _fields: WorldFields
    _targets: Targets
    _physics: Physics
    _fingertips: Fingertips
    _latency: CommandLatency
    _views: Sequence[str]
    _environment_state: bool
    _origin: np.ndarray

    @property
    def acting(self) -> np.ndarray:
        """(N,) bool, the control phase has begun: the hand may move during this frame."""
        return self.frame >= self._windows

    @property
    def accepting(self) -> np.ndarray:
        """(N,) bool, a command given at this frame takes effect in the control phase; earlier ones are void."""
        return self.frame + self.control.latency_frames >= self._windows

    @property
    def _windows(self) -> np.ndarray:
        """(N,) int, length of each world's observation window [frames]."""
        return np.array([0 if spec is None else spec.window_frames for spec in self.specs])

    @property
    def state(self) -> np.ndarray:
        """(N, 18) palm centre position [m], home frame, and joint angles [rad], as measured."""
        return self._fields.qpos[:, self.scene.hand_qpos] - self._origin

    @property
    def home_pos_w(self) -> np.ndarray:
        """(N, 3) the origin of each world's home frame [m], world."""
        return self._origin[:, :PALM_DOF].copy()

    @property
    def target_pose(self) -> np.ndarray:
        """(N, 7) position [m], home frame, and quaternion wxyz."""
        pose = self._targets.pose
        pose[:, :PALM_DOF] -= self.home_pos_w
        return pose

    @property
    def target_velocity(self) -> np.ndarray:
        """(N, 6) linear [m/s] and angular [rad/s] velocity, along the world's axes."""
        return self._targets.velocity

    @property
    def localized(self) -> np.ndarray:
        """(N,) bool, the target has been localised in the control phase."""
        return self._physics.localized

    @property
    def released(self) -> np.ndarray:
        """(N,) bool, the capture rule's event has happened: the target is attached, or free, and keeps to no path."""
        return self._targets.released

    @property
    def palm_distance(self) -> np.ndarray:
        """(N,) [m], least distance of palm and target centre during the last control step."""
        return self._physics.palm_distance

    @property
    def contacts(self) -> TargetContacts:
        """What touched the target during the last control step, mean of its physics steps, of shape (N,)."""
        return self._physics.contacts

    def fingertips(self) -> np.ndarray:
        """Return (N, 30), position [m], home frame, and rotation vector [rad] of each fingertip."""
        return self._fingertips.poses(self.home_pos_w)

    def tip_distance(self) -> np.ndarray:
        """Return (N, 5), signed distance of each fingertip to the target's surface [m], negative inside."""
        return self._fingertips.target_distance()

    def touching(self) -> np.ndarray:
        """Return (N, 5) bool, the fingers that touch the target, or would if they collided."""
        if self.rule.uses_contact_sensors:
            return self.contacts.finger_force_n > 0
        return self.tip_distance() <= TOUCH_M

    def observe(self, *, images: bool, ids: np.ndarray | None = None) -> Observation:
        """Return what a policy may see.

        Args:
            images: whether to render the views; without, they cost nothing.
            ids: the worlds to render (default: all); the images of the others are black, as are those of worlds in the
                control phase of a protocol with ``blind_control``.
        """
        sensed = self.rule.uses_contact_sensors
        return Observation(
            images={view: self.cameras.render(self._seeing(ids), view) for view in self._views} if images else {},
            state=self.state.astype(np.float32),
            phase=one_hot_phase(self.accepting),
            tasks=tuple("" if spec is None else spec.task for spec in self.specs),
            touch=self.contacts.finger_force_n.astype(np.float32) if sensed else None,
            environment_state=self._truth() if self._environment_state else None,
        )

    def _truth(self) -> np.ndarray:
        """(N, 13) float32 pose [m, 1] and velocity [m/s, rad/s] of the targets."""
        return np.concatenate([self.target_pose, self.target_velocity], axis=1, dtype=np.float32, casting="same_kind")

    def _seeing(self, ids: np.ndarray | None) -> np.ndarray:
        """(n,) those of worlds ``ids`` (default: all) whose protocol lets them see now."""
        blind = np.array([spec is not None and protocol_of(spec.protocol).blind_control for spec in self.specs])
        return np.setdiff1d(np.arange(self.size) if ids is None else ids, np.flatnonzero(blind & self.acting))

    def world_state(self, observation: Observation) -> WorldState:
        """Return what an expert sees: the observation and everything the simulator knows."""
        return WorldState(
            observation=observation,
            specs=tuple(self.specs),
            frame=self.frame.copy(),
            attempt=self.attempt.copy(),
            target_pose=self.target_pose,
            target_velocity=self.target_velocity,
            target_contacts=self.touching(),
            localized=self.localized.copy(),
            control=self.control,
            localization_radius_m=self.rule.localization_radius_m,
            state_when_due=self._state_when_due(),
        )

    def _state_when_due(self) -> np.ndarray:
        """(N, 18) where undisturbed hands will be when a command given now takes effect."""
        state = self.executed.copy()
        for command in self._latency.pending():
            state = self.servo.within_reach(command, state, self._origin)
        return state
