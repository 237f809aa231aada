"""N worlds = N rows over one model: reset a row, step all of them, observe them. Everything else stands on this."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.agent import Observation, WorldState
from dynahoi_lerobot.core.control_mode import CONTROL_MODES, GRASP, JOINTS, from_grasp, to_grasp
from dynahoi_lerobot.core.conventions import DETECTOR_IMAGE_SIZE_PX, EGO_VIEW, HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.features import EYE, TRUTH
from dynahoi_lerobot.core.rules import CONTROL_CLASSES, PROTOCOLS, one_hot_phase
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.motions import PrescribedMotion
from dynahoi_lerobot.renderers.views import MOTION_VIEW
from dynahoi_lerobot.scene.scene import Scene, compile_scene
from dynahoi_lerobot.scene.servo import Servo, check_command
from dynahoi_lerobot.scene.world_fields import WorldFields
from dynahoi_lerobot.world.physics import Physics
from dynahoi_lerobot.world.sensors import Cameras, Fingertips, ImageHistory, camera_pose, intrinsics, with_render_noise

if TYPE_CHECKING:
    from dynahoi_lerobot.sampling.recipe import Recipe
    from dynahoi_lerobot.world.detector import Detector

KINEMATICS = mujoco.mjtStage.mjSTAGE_POS.value
STAGE_FRAMES = 32
"""Frames of an episode that are rendered together once it has ended."""
TOUCH_M = 0.005
"""A fingertip this close touches the target: the sphere-overlap test of Appendix "Data collection"."""


class WorldBatch:
    """N simulated worlds that share one compiled model and one clock rate, each at its own frame of its own episode.

    Every array below has one row per world. Rows are independent to the bit: what happens in one depends neither on
    its neighbours, nor on the size of the batch, nor on the number of threads.

    Positions are in the *home frame*: axes of the world, origin at the palm's home in this episode. The simulation
    underneath keeps the world frame; this class converts.

    Attributes:
        recipe, size: as given.
        scene: the compiled model and where things are in it.
        rule: the capture rule.
        cameras: renders the worlds.
        specs: the episode of each world, None where none has begun.
        frame: (N,) int, current frame of each world's episode.
        attempt: (N,) int, from 1.
        control: the control class, whose limits every command is held to.
        palm_speed_m_s: the limit of the palm: the control class's, or that of the capture rule's gantry [m/s].
        servo: what holds them to it.
        given: (N, 18) the command last given, cut to what a hand can meet when it takes effect.
        executed: (N, 18) what the servos were last told: the command that was due, cut to the speed limits.
        localized, palm_distance, contacts: what `Physics` keeps of the last control step.
    """

    def __init__(self, recipe: Recipe, size: int, threads: int = 0) -> None:
        """Allocate ``size`` worlds.

        Args:
            recipe: rules of the episodes; their motions, objects and seeds do not matter here.
            size: N.
            threads: for physics, 0 for all cores; without influence on the result.

        Raises:
            ValueError: if ``size`` is not positive or a name is unknown.
        """
        if size < 1:
            raise ValueError(f"a batch needs at least 1 world, got {size}")
        self.recipe, self.size = recipe, size
        self.scene: Scene = compile_scene(recipe.hand)
        self.rule = CAPTURES[recipe.capture]()
        self._batch = Batch(self.scene.model, nsim=size, nthread=threads)
        self._fields = WorldFields(self._batch, self.scene)
        self.control = CONTROL_CLASSES[recipe.control_class]
        self.palm_speed_m_s = self.rule.palm_speed_m_s(self.control)
        by_axis = self.rule.gantry_speed_m_s is not None
        self.servo = Servo(self.scene.model, self.palm_speed_m_s, self.control.joint_speed_rad_s, by_axis=by_axis)
        self._pending = np.zeros((self.control.latency_frames, size, HAND_DOF))  # commands on their way, oldest first
        self._physics = Physics(self.scene, self._batch, self._fields, self.rule)
        self.localized, self.palm_distance = self._physics.localized, self._physics.palm_distance
        self.contacts = self._physics.contacts
        self._fingertips = Fingertips(self.scene, self._batch, self._fields)
        image_size = recipe.image_size or (DETECTOR_IMAGE_SIZE_PX if recipe.environment_state == EYE else 0)
        self.cameras = Cameras(self.scene, self._batch, image_size, recipe.renderer, self._update_kinematics)
        self._history = ImageHistory(size, recipe.image_size)
        self._detector = self._make_detector() if recipe.environment_state == EYE else None
        self._threads, self._stage = threads, None
        self.specs: list[EpisodeSpec | None] = [None] * size
        self.frame, self.attempt = np.zeros(size, int), np.ones(size, int)
        self.given, self.executed = np.zeros((2, size, HAND_DOF))
        self._origin = np.zeros((size, HAND_DOF))  # homes [m], world, and zero for the joints

    def reset(
        self, ids: Sequence[int] | np.ndarray, specs: Sequence[EpisodeSpec], attempt: Sequence[int] | int = 1
    ) -> None:
        """Begin an episode in each world of ``ids``: target at its start, hand open at home.

        Args:
            ids: sorted, distinct worlds.
            specs: one episode for each.
            attempt: how often each has been begun, for experts that try something else then.
        """
        chosen = np.asarray(ids, int)
        self.frame[chosen], self.attempt[chosen] = 0, attempt
        self._history.forget(chosen)
        if self._detector is not None:
            self._detector.forget(chosen)
        self._fields.reset(chosen)
        for i, spec in zip(chosen, specs, strict=True):
            self._write(int(i), spec)
        self._fields.finish(chosen)
        self._fingertips.forget()
        distance = np.linalg.norm(self.target_pose[:, :3] - self.state[:, :PALM_DOF], axis=1)
        self._physics.reset(chosen, distance[chosen])

    def place(self, state: np.ndarray, target_pose: np.ndarray) -> None:
        """Pose hands and targets of all worlds without physics, to look at them; what was going on there is lost.

        Args:
            state: (N, 18) palm centre position [m], home frame, and joint angles [rad].
            target_pose: (N, 7) position [m], home frame, and quaternion wxyz.
        """
        first = self.scene.target_qpos
        self._fields.qpos[:, self.scene.hand_qpos] = state + self._origin
        self._fields.qpos[:, first : first + 7] = target_pose
        self._fields.qpos[:, first : first + PALM_DOF] += self.home_pos_w
        self._update_kinematics()

    def step(self, commands: np.ndarray, ids: np.ndarray | None = None) -> None:
        """Advance worlds ``ids`` (default: all) by one control step of 0.05 s.

        During the observation window the hand is held at home; commands that would take effect in it are void.

        Args:
            commands: (n, 18) palm positions [m], home frame, and joint angles [rad].
            ids: sorted, distinct worlds.

        Raises:
            ValueError: for a wrong shape or a value that is not finite; no world moves then.
        """
        chosen = np.arange(self.size) if ids is None else np.asarray(ids)
        wanted = check_command(commands, len(chosen))
        if not len(chosen):
            return
        previous, acting, origin = self.executed[chosen], self.acting[chosen], self._origin[chosen]
        given = self._accepted(wanted, chosen)
        due = self._exchange(chosen, given)
        executed = self.servo.within_reach(due, previous, origin)
        set_points = self.servo.set_points(executed, previous) + origin[:, None]  # (n, 25, 18)
        self._physics.advance(chosen, set_points, self.frame[chosen], acting)
        self.given[chosen], self.executed[chosen] = given, executed
        self.frame[chosen] += 1
        self._update_kinematics(chosen)

    def as_commands(self, actions: np.ndarray, observation: Observation) -> np.ndarray:
        """Return (N, 18) the commands of actions given on an observation, refused as by ``step``.

        Experts' commands stay what they are.

        Args:
            actions: (N, 4) in control mode ``grasp``, or (N, 18) commands.
            observation: of all worlds, from which displacements are counted.
        """
        actions = np.asarray(actions)
        if self.recipe.control_mode == JOINTS or actions.shape[1:] == (HAND_DOF,):
            return check_command(actions, self.size)
        given = check_command(actions, self.size, len(CONTROL_MODES[GRASP]))
        return from_grasp(given, observation.state.astype(np.float64), *self._open_and_closed)

    def as_labels(self, goals: np.ndarray, observation: Observation) -> np.ndarray:
        """Return (N, 18) or (N, 4) the actions, in the recipe's control mode, of a teacher's goals on an observation.

        Args:
            goals: (N, 18) palm positions [m], home frame, and joint angles [rad]; cut to slides and joint ranges.
            observation: as for ``as_commands``.
        """
        commands = np.clip(goals, self.servo.low - self._origin, self.servo.high - self._origin)
        if self.recipe.control_mode == JOINTS:
            return commands
        return to_grasp(commands, observation.state.astype(np.float64), *self._open_and_closed)

    @property
    def _open_and_closed(self) -> tuple[np.ndarray, np.ndarray]:
        """(15,) joint angles of the open and of the closed hand [rad]."""
        return self.scene.hand.open_joints(), self.scene.hand.closed_joints()

    def action_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (18,) or (4,) least and greatest actions in the recipe's control mode, as ``command_limits``."""
        low, high = self.command_limits()
        if self.recipe.control_mode == JOINTS:
            return low, high
        return np.append(low[:PALM_DOF], np.float32(0)), np.append(high[:PALM_DOF], np.float32(1))

    def command_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (18,) least and greatest commands, float32, in any episode: palm [m] and joint ranges [rad].

        The palm's are the whole length of each slide either way: where on them the home lies is not told.
        """
        length = self.servo.high - self.servo.low
        palm = np.arange(HAND_DOF) < PALM_DOF
        low, high = np.where(palm, -length, self.servo.low), np.where(palm, length, self.servo.high)
        return low.astype(np.float32), high.astype(np.float32)

    @property
    def acting(self) -> np.ndarray:
        """(N,) bool, the control phase has begun: the hand may move during this frame."""
        return self.frame >= self._windows

    @property
    def accepting(self) -> np.ndarray:
        """(N,) bool, a command given at this frame takes effect in the control phase; earlier ones are void."""
        return self.frame + self.control.latency_frames >= self._windows

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
        pose = self._physics.target_pose
        pose[:, :PALM_DOF] -= self.home_pos_w
        return pose

    @property
    def target_velocity(self) -> np.ndarray:
        """(N, 6) linear [m/s] and angular [rad/s] velocity, along the world's axes."""
        return self._physics.target_velocity

    def tip_distance(self) -> np.ndarray:
        """Return (N, 5), signed distance of each fingertip to the target's surface [m], negative inside."""
        return self._fingertips.target_distance()

    def fingertips(self) -> np.ndarray:
        """Return (N, 30), position [m], home frame, and rotation vector [rad] of each fingertip."""
        return self._fingertips.poses(self.home_pos_w)

    def touching(self) -> np.ndarray:
        """Return (N, 5) bool, the fingers that touch the target, or would if they collided."""
        if self.rule.uses_contact_sensors:
            return self.contacts.finger_force_n > 0
        return self.tip_distance() <= TOUCH_M

    def observe(self, *, images: bool = True, ids: np.ndarray | None = None) -> Observation:
        """Return what a policy may see.

        Args:
            images: whether to render the views of the recipe; without, they cost nothing.
            ids: the worlds to render (default: all); the images of the others are black, as are those of worlds in the
                control phase of a protocol with ``blind_control``.
        """
        sensed, state = self.rule.uses_contact_sensors, self.state
        shown = self._images(self._seeing(ids)) if images and self.recipe.image_size else {}
        return Observation(
            images=shown,
            state=state.astype(np.float32),
            phase=one_hot_phase(self.accepting),
            tasks=tuple("" if spec is None else spec.task for spec in self.specs),
            touch=self.contacts.finger_force_n.astype(np.float32) if sensed else None,
            environment_state=np.concatenate([self.target_pose, self.target_velocity], axis=1).astype(np.float32)
            if self.recipe.environment_state == TRUTH
            else None,
            sighting=self._sighting(self._detector, shown, state, ids) if self._detector else None,
        )

    @property
    def renders_later(self) -> bool:
        """Whether images can be rendered once an episode has ended: no image depends on others, no column on any."""
        return self.recipe.image_size > 0 and self._detector is None and MOTION_VIEW not in self.recipe.views

    @property
    def qpos(self) -> np.ndarray:
        """(N, nq) MuJoCo's configuration of each world."""
        return self._fields.qpos.copy()

    def images_of(self, i: int, qpos: np.ndarray) -> dict[str, np.ndarray]:
        """Return the views of world ``i`` in the first T frames of its episode, of which (T, nq) ``qpos`` was recorded.

        They are (T, H, W, 3) uint8, the same that ``observe`` would have shown.
        """
        stage = self._stage = self._stage or WorldBatch(self.recipe, STAGE_FRAMES, self._threads)
        parts = []
        for first in range(0, len(qpos), stage.size):
            rows = stage._fields.copy(self._fields, i, qpos[first : first + stage.size])
            stage.specs, stage.frame = [self.specs[i]] * stage.size, first + np.arange(stage.size)
            stage._update_kinematics(rows)
            parts.append({view: images[rows] for view, images in stage._images(stage._seeing(rows)).items()})
        return {view: np.concatenate([part[view] for part in parts]) for view in parts[0]}

    def world_state(self, observation: Observation) -> WorldState:
        """Return what an expert sees: the observation and everything the simulator knows."""
        return WorldState(
            observation=observation,
            specs=tuple(self.specs),
            frame=self.frame.copy(),
            attempt=self.attempt.copy(),
            target_pose=self.target_pose,
            target_velocity=self.target_velocity,
            localized=self.localized.copy(),
            control=self.control,
            localization_radius_m=self.rule.localization_radius_m,
            state_when_due=self._state_when_due(),
        )

    def _accepted(self, wanted: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """(n, 18) commands cut to what hands can meet when they take effect; void ones become holding still."""
        # taken as it is stored, in single precision, so that a replay of stored actions is the same to the bit
        reached = self.servo.within_reach(wanted, self._state_when_due()[chosen], self._origin[chosen])
        given = reached.astype(np.float32).astype(np.float64)
        return np.where(self.accepting[chosen, None], given, self.executed[chosen])

    def _exchange(self, chosen: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Take the commands (n, 18) given to worlds ``chosen`` (n,) and return (n, 18) those that are due."""
        if not len(self._pending):
            return given
        due = self._pending[0, chosen].copy()
        self._pending[:-1, chosen] = self._pending[1:, chosen]
        self._pending[-1, chosen] = given
        return due

    def _write(self, i: int, spec: EpisodeSpec) -> None:
        """Fill row ``i`` with an episode that is about to begin."""
        collides_with = self.rule.collisions(spec.motion)
        force_w = self._fields.write_world(i, spec.motion, spec.target, spec.horizon_frames, collides_with)
        self._physics.drive(i, force_w)
        if isinstance(spec.motion, PrescribedMotion):
            self._fields.turn_target(i, spec.yaw_rad, spec.spin_rad_s)
        self._fields.write_appearance(i, spec.appearance)
        self._fields.place_side_camera(i, spec.home_pos_w)
        # rounded as commands are, or the hand would creep and, by rounding, disturb what slides or rests
        rest = np.concatenate([np.zeros(PALM_DOF), self.scene.hand.open_joints()]).astype(np.float32)
        self.given[i] = self.executed[i] = rest
        self._pending[:, i] = rest
        self._origin[i, :PALM_DOF] = spec.home_pos_w
        self._fields.qpos[i, self.scene.hand_qpos] = rest + self._origin[i]
        self.specs[i] = spec

    def _update_kinematics(self, ids: np.ndarray | None = None) -> None:
        """Recompute the poses of worlds ``ids`` (default: all)."""
        self._fingertips.forget()
        self._batch.forward(ids, stage=KINEMATICS) if ids is not None else self._batch.forward(stage=KINEMATICS)

    @property
    def _windows(self) -> np.ndarray:
        """(N,) int, length of each world's observation window [frames]."""
        return np.array([0 if spec is None else spec.window_frames for spec in self.specs])

    def _images(self, ids: np.ndarray) -> dict[str, np.ndarray]:
        """(N, H, W, 3) uint8 of each of the recipe's views; only worlds ``ids`` (n,) are drawn, others are black."""
        views = [EGO_VIEW, *self.recipe.views]
        images = {view: self._render(view, ids) for view in views if view != MOTION_VIEW}
        if MOTION_VIEW in views:
            images[MOTION_VIEW] = self._history.shown(images[EGO_VIEW], ids, self.frame)
        return {view: images[view] for view in views}

    def _render(self, view: str, ids: np.ndarray) -> np.ndarray:
        """(N, H, W, 3) uint8 RGB of a view with its render noise; only worlds ``ids`` (n,) are drawn."""
        images, levels = self.cameras.render(ids, view), self.recipe.render_noise
        if levels:
            images = images.copy()
            for i in ids:
                if (spec := self.specs[i]) is not None:
                    images[i] = with_render_noise(images[i], levels, spec.seed, int(self.frame[i]), view)
        return images

    def _make_detector(self) -> Detector:
        """Return the eye, which comes with the ObAct plugin; ValueError if that is not installed."""
        try:
            from dynahoi_lerobot.world.detector import Detector
        except ImportError as error:
            raise ValueError(f"environment_state {EYE} needs ObAct ({error}): install lerobot_policy_obact") from error
        model = self.scene.model
        return Detector(self.size, camera_pose(model, EGO_VIEW), intrinsics(model, EGO_VIEW, self.cameras.image_size))

    def _sighting(
        self, detector: Detector, shown: dict[str, np.ndarray], state: np.ndarray, ids: np.ndarray | None
    ) -> np.ndarray:
        """(N, 14) float32 where the eye sees the targets of worlds ``ids`` (default: all), in what is shown or not."""
        images = shown[EGO_VIEW] if shown else self._render(EGO_VIEW, self._seeing(ids))
        return detector.see(images, state[:, :PALM_DOF], np.arange(self.size) if ids is None else ids, self.frame)

    def _seeing(self, ids: np.ndarray | None) -> np.ndarray:
        """(n,) those of worlds ``ids`` (default: all) whose protocol lets them see now."""
        blind = np.array([spec is not None and PROTOCOLS[spec.protocol].blind_control for spec in self.specs])
        return np.setdiff1d(np.arange(self.size) if ids is None else ids, np.flatnonzero(blind & self.acting))

    def _state_when_due(self) -> np.ndarray:
        """(N, 18) where hands will be when a command given now takes effect."""
        state = self.executed.copy()
        for command in self._pending:
            state = self.servo.within_reach(command, state, self._origin)
        return state
