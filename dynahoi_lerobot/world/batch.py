"""N worlds = N rows over one model: reset a row, step all of them, observe them. Everything else stands on this."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.agent import Observation, WorldState
from dynahoi_lerobot.captures.base import CAPTURES, NO_EVENT, Substeps
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import FINGER_DOF, FINGERS, LOCALIZATION_RADIUS_M, PALM_DOF, SUBSTEPS
from dynahoi_lerobot.foundation.rotations import matrix_to_rotvec, quat_to_matrix
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.motions import PrescribedMotion
from dynahoi_lerobot.renderers import DEFAULT_RENDERER, RENDERERS, Renderer
from dynahoi_lerobot.renderers.camera_views import VIEWS
from dynahoi_lerobot.scene.contact_sensors import TOUCHING, read_touch
from dynahoi_lerobot.scene.scene import Scene, compile_scene
from dynahoi_lerobot.scene.servo import Servo, check_command
from dynahoi_lerobot.scene.signed_distance import signed_distance
from dynahoi_lerobot.scene.target_drive import drive_for
from dynahoi_lerobot.scene.world_fields import WorldFields
from dynahoi_lerobot.world.disturbance import draw_disturbance

CONTROL_SPEC = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
KINEMATICS = mujoco.mjtStage.mjSTAGE_POS.value
TOUCH_M = 0.005
"""A fingertip this close touches the target: the sphere-overlap test of Appendix "Data collection"."""


class WorldBatch:
    """N simulated worlds that share one compiled model and one clock rate, each at its own frame of its own episode.

    Every array below has one row per world. Rows are independent to the bit: what happens in one depends
    neither on its neighbours, nor on the size of the batch, nor on the number of threads.

    Attributes:
        size: N.
        frame: (N,) int, current frame of each world's episode; ``attempt``: (N,) int, from 1.
        localized: (N,) bool, the target has been localised in the control phase.
        palm_distance: (N,) [m], least distance of palm and target centre during the last control step.
        touch: (N, 7) what touched the target in the last control step, see ``touch.TOUCHING``; mean forces [N]. Zero if
            the capture rule does not ask for it.
        executed: (N, 18) the command last given, after clipping; the hand meets it unless it is pushed.
    """

    def __init__(
        self,
        size: int,
        *,
        capture: str = "attach",
        hand: str = "capsule",
        image_size: int = 128,
        views: Sequence[str] = (),
        renderer: str = DEFAULT_RENDERER,
        threads: int = 0,
        disturbance_m: float = 0.0,
    ) -> None:
        """Allocate ``size`` worlds; ``threads`` simulate them (0: all cores), without influence on the result.

        ``views`` are drawn besides the hand's camera (`camera_views.py`); ``disturbance_m`` is the spread of the pushes
        that make the palm miss its commands.

        Raises:
            ValueError: if ``size`` is not positive or a name is unknown.
        """
        if size < 1:
            raise ValueError(f"a batch needs at least 1 world, got {size}")
        self.size = size
        self.scene: Scene = compile_scene(hand)
        self.rule = CAPTURES[capture]()
        self._renderer_class, self._image_size, self._views = RENDERERS[renderer], image_size, tuple(views)
        self._renderers: dict[str, Renderer] = {}
        self._batch = Batch(self.scene.model, nsim=size, nthread=threads)
        self._rows = WorldFields(self._batch, self.scene)
        self._servo = Servo(self.scene.model)
        self._ctrl = self._batch.bind("ctrl")
        self._xpos, self._xmat = self._batch.bind("geom_xpos"), self._batch.bind("geom_xmat")
        self._site_xpos, self._site_xmat = self._batch.bind("site_xpos"), self._batch.bind("site_xmat")
        self.specs: list[EpisodeSpec | None] = [None] * size
        self.frame, self.attempt = np.zeros(size, int), np.ones(size, int)
        self.localized = np.zeros(size, bool)
        self.palm_distance = np.full(size, np.inf)
        self.executed = np.zeros((size, PALM_DOF + FINGER_DOF))
        self._held = self.executed.copy()
        self._disturbance_m, self._disturbance = disturbance_m, [np.zeros((0, PALM_DOF))] * size
        self.touch = np.zeros((size, len(TOUCHING)))
        self._let_go = np.zeros(size, bool)
        self._tip_distance: np.ndarray | None = None
        self._force: list[np.ndarray] = [np.zeros((0, SUBSTEPS, 3))] * size

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
        self._tip_distance = None
        self._rows.reset(chosen)
        for i, spec in zip(chosen, specs, strict=True):
            self._write(int(i), spec)
        self._rows.finish(chosen)
        self.frame[chosen], self.attempt[chosen] = 0, attempt
        self._held[chosen] = self.executed[chosen]
        if self._disturbance_m:
            for i, spec in zip(chosen, specs, strict=True):
                self._disturbance[i] = draw_disturbance(spec, int(self.attempt[i]), self._disturbance_m)
        self.localized[chosen], self._let_go[chosen], self.touch[chosen] = False, False, 0.0
        self.palm_distance[chosen] = self._center_distance()[chosen]

    def step(self, commands: np.ndarray, ids: np.ndarray | None = None) -> None:
        """Advance worlds ``ids`` (default: all) by one control step of 0.05 s.

        During the observation window commands are ignored and the hand is held at home.

        Args:
            commands: (n, 18) palm positions [m], world, and joint angles [rad].
            ids: sorted, distinct worlds.

        Raises:
            ValueError: for a wrong shape or a value that is not finite; no world moves then.
        """
        chosen = np.arange(self.size) if ids is None else np.asarray(ids)
        wanted = check_command(commands, len(chosen))
        if not len(chosen):
            return
        previous = self._held[chosen]
        wanted = np.where(self.acting[chosen, None], wanted, previous)
        self._tip_distance = None
        # executed as it is stored, in single precision: where there is contact, a rounding error grows
        command = self._servo.clip(wanted, previous).astype(np.float32).astype(np.float64)
        reached = self._servo.clip(command + self._pushed(chosen), previous)
        control = np.zeros((len(chosen), SUBSTEPS, self._ctrl.shape[1] + self.scene.model.nv))
        control[..., : self._ctrl.shape[1]] = self._servo.set_points(reached, previous)
        dof = self._ctrl.shape[1] + self.scene.target_dof
        control[..., dof : dof + 3] = [self._drive_force(int(i)) for i in chosen]
        self._advance(chosen, control)
        self.executed[chosen], self._held[chosen] = command, reached
        self.frame[chosen] += 1
        self._batch.forward(chosen, stage=KINEMATICS)

    def _pushed(self, chosen: np.ndarray) -> np.ndarray:
        """Return (n, 18) by how much the worlds ``chosen`` miss their commands at this frame."""
        missed = np.zeros((len(chosen), self.executed.shape[1]))
        if self._disturbance_m:
            missed[:, :PALM_DOF] = [self._disturbance[i][self.frame[i]] for i in chosen]
        return missed

    def check(self, commands: np.ndarray) -> np.ndarray:
        """Return (N, 18) float64 commands for all worlds; raise ValueError as ``step`` would."""
        return check_command(commands, self.size)

    def command_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (18,) least and greatest commands, float32: reach of the palm [m] and joint ranges [rad]."""
        return self._servo.low.astype(np.float32), self._servo.high.astype(np.float32)

    @property
    def acting(self) -> np.ndarray:
        """(N,) bool, the control phase has begun: the command of this frame moves the hand."""
        windows = [0 if spec is None else spec.window_frames for spec in self.specs]
        return self.frame >= np.asarray(windows)

    @property
    def state(self) -> np.ndarray:
        """(N, 18) palm centre position [m], world, and joint angles [rad], as measured."""
        return self._rows.qpos[:, self.scene.hand_qpos]

    @property
    def target_pose(self) -> np.ndarray:
        """(N, 7) position [m] and quaternion wxyz, world."""
        return self._rows.qpos[:, self.scene.target_qpos : self.scene.target_qpos + 7].copy()

    @property
    def target_velocity(self) -> np.ndarray:
        """(N, 6) linear [m/s] and angular [rad/s] velocity, world."""
        dof = self.scene.target_dof
        velocity = self._rows.qvel[:, dof : dof + 6].copy()
        velocity[:, 3:] = (quat_to_matrix(self.target_pose[:, 3:]) * velocity[:, None, 3:]).sum(axis=-1)
        return velocity

    def tip_distance(self) -> np.ndarray:
        """Return (N, 5), signed distance of each fingertip to the target's surface [m], negative inside."""
        if self._tip_distance is None:  # experts, recordings and contacts ask for the same one
            self._tip_distance = self._measure_tips()
        return self._tip_distance

    def _measure_tips(self) -> np.ndarray:
        tips = self._site_xpos[:, self.scene.tip_sites]  # (N, 5, 3)
        nearest = np.full(tips.shape[:2], np.inf)
        alpha, sizes = self._rows.fields["geom_rgba"][..., 3], self._rows.fields["geom_size"]
        for shape, ids in self.scene.slots.items():
            geoms = np.asarray(ids)
            offset = tips[:, :, None] - self._xpos[:, None, geoms]  # (N, 5, S, 3)
            rotation = self._xmat[:, geoms].reshape(self.size, 1, len(geoms), 3, 3)
            local = (rotation * offset[..., None]).sum(axis=-2)  # transposed rotation times offset
            distance = signed_distance(shape, local, np.broadcast_to(sizes[:, None, geoms], local.shape))
            hidden = (alpha[:, geoms] == 0.0)[:, None]
            nearest = np.minimum(nearest, np.where(hidden, np.inf, distance).min(axis=2))
        return nearest

    def fingertips(self) -> np.ndarray:
        """Return (N, 30), position [m] and rotation vector [rad] of each fingertip, world."""
        position = self._site_xpos[:, self.scene.tip_sites]
        rotation = self._site_xmat[:, self.scene.tip_sites].reshape(self.size, len(FINGERS), 3, 3)
        vectors = matrix_to_rotvec(rotation)
        return np.concatenate([position, vectors], axis=-1).reshape(self.size, -1)

    def observe(self, *, images: bool, ids: np.ndarray | None = None) -> Observation:
        """Return what a policy may see.

        Args:
            images: whether to render the views; without, they cost nothing.
            ids: the worlds to render (default: all); the images of the others are black.
        """
        return Observation(
            images=self.render(ids) if images else None,
            state=self.state.astype(np.float32),
            fingertips=self.fingertips().astype(np.float32),
            phase=self.acting[:, None].astype(np.float32),
            tasks=tuple("" if spec is None else spec.task for spec in self.specs),
            touch=self.touch[:, : len(FINGERS)].astype(np.float32) if self.rule.uses_contact_sensors else None,
            views={view: self.render(ids, view) for view in self._views} if images else {},
        )

    def world_state(self, observation: Observation) -> WorldState:
        """Return what an expert sees: the observation and everything the simulator knows."""
        return WorldState(
            observation=observation,
            specs=tuple(self.specs),
            frame=self.frame.copy(),
            attempt=self.attempt.copy(),
            target_pose=self.target_pose,
            target_velocity=self.target_velocity,
            target_contacts=self.contacts(),
        )

    def contacts(self) -> np.ndarray:
        """Return (N, 5) bool, the fingers that touch the target, or would if they collided."""
        if self.rule.uses_contact_sensors:
            return self.touch[:, : len(FINGERS)] > 0
        return self.tip_distance() <= TOUCH_M

    def render(self, ids: np.ndarray | None = None, view: str = EGO_CAMERA) -> np.ndarray:
        """Return (N, H, W, 3) uint8 RGB of a view; only worlds ``ids`` (default: all) are drawn."""
        camera, draw = VIEWS[view]
        if ids is None or len(ids) == self.size:
            return draw(self._renderer(camera), np.arange(self.size))
        images = np.zeros((self.size, self._image_size, self._image_size, 3), np.uint8)
        images[ids] = draw(self._renderer(camera), np.asarray(ids))
        return images

    def segmentation(self) -> np.ndarray:
        """Return (N, H, W) int32 geom ids seen by the hand's camera, -1 where nothing is."""
        return self._renderer(EGO_CAMERA).segmentation(np.arange(self.size))

    def depth(self) -> np.ndarray:
        """Return (N, H, W) float32 depth seen by the hand's camera [m], 0 where nothing is."""
        return self._renderer(EGO_CAMERA).depth(np.arange(self.size))

    def weld_target(self, i: int) -> None:
        """Fix the target of world ``i`` to the palm as it lies, at the palm's velocity, free of everything else."""
        self.release_target(i, 0)
        scene, rows = self.scene, self._rows
        position = rows.qpos[i, scene.target_qpos : scene.target_qpos + 3]
        quat = rows.qpos[i, scene.target_qpos + 3 : scene.target_qpos + 7]
        inverse, offset = np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(inverse, quat)
        mujoco.mju_rotVecQuat(offset, rows.qpos[i, scene.hand_qpos[:PALM_DOF]] - position, inverse)
        data = rows.fields["eq_data"]
        data[i, scene.weld_eq] = 0.0
        data[i, scene.weld_eq, 3:6], data[i, scene.weld_eq, 6:10] = offset, inverse
        data[i, scene.weld_eq, 10] = 1.0
        rows.eq_active[i, scene.weld_eq] = 1
        dof = scene.target_dof
        rows.qvel[i, dof : dof + 3] = rows.qvel[i, scene.hand_dof[:PALM_DOF]]
        rows.qvel[i, dof + 3 : dof + 6] = 0.0

    def release_target(self, i: int, collides_with: int) -> None:
        """Stop driving the target of world ``i`` and cut its string; it keeps its velocity.

        Args:
            i: the world.
            collides_with: collision bits that the target asks for from now on.
        """
        self._rows.free_target(i)
        self._rows.set_collisions(i, collides_with)
        self._let_go[i] = True

    def _renderer(self, camera: str) -> Renderer:
        """The renderer of a camera, prepared when it is first used."""
        if camera not in self._renderers:
            self._renderers[camera] = self._renderer_class(self.scene, self._batch, self._image_size, camera)
            self._batch.forward(stage=KINEMATICS)  # fills the poses that the renderer has just asked for
        return self._renderers[camera]

    def _write(self, i: int, spec: EpisodeSpec) -> None:
        drive = drive_for(spec.motion, spec.target, spec.horizon_frames)
        self._rows.write_world(i, spec.motion, spec.target, drive, self.rule.collisions(spec.motion))
        if isinstance(spec.motion, PrescribedMotion):
            self._rows.turn_target(i, spec.yaw_rad, spec.spin_rad_s)
        self._rows.write_appearance(i, spec.appearance)
        self._rows.place_side_camera(i, spec.home_pos_w)
        assert self.scene.hand is not None
        # rounded as commands are, or the hand would creep to its home and, by rounding, disturb what slides or rests
        self.executed[i] = np.concatenate([spec.home_pos_w, self.scene.hand.open_joints()]).astype(np.float32)
        self._rows.qpos[i, self.scene.hand_qpos] = self.executed[i]
        self.specs[i], self._force[i] = spec, drive.force_w

    def _drive_force(self, i: int) -> np.ndarray:
        """(25, 3) force [N] on the target of world ``i`` during its next frame."""
        if self._let_go[i] or self.frame[i] >= len(self._force[i]):
            return np.zeros((SUBSTEPS, 3))
        return self._force[i][self.frame[i]]

    def _advance(self, ids: np.ndarray, control: np.ndarray) -> None:
        """Roll one control step; where the capture rule has an event, go back and insert it."""
        before = self._batch.state[ids].copy()
        substeps = self._roll(ids, control)
        self.palm_distance[ids] = substeps.palm_distance.min(axis=1)
        self.localized[ids] |= substeps.acting & (self.palm_distance[ids] < LOCALIZATION_RADIUS_M)
        events = np.where(self._let_go[ids], NO_EVENT, self.rule.events(substeps))
        for row in np.flatnonzero(events != NO_EVENT):
            self._batch.state[ids[row]] = before[row]
            self._roll_through_event(int(ids[row]), control[row : row + 1], int(events[row]) + 1)

    def _roll_through_event(self, i: int, control: np.ndarray, steps: int) -> None:
        """Roll world ``i`` for ``steps`` physics steps, apply the capture rule, and finish the control step."""
        one = np.array([i])
        self._roll(one, control[:, :steps])
        self.rule.apply(self, i)
        if steps < SUBSTEPS:
            rest = control[:, steps:].copy()
            rest[..., self._ctrl.shape[1] :] = 0.0  # whatever drove the target lets go
            self._roll(one, rest)

    def _roll(self, ids: np.ndarray, control: np.ndarray) -> Substeps:
        """Roll physics steps, and keep what touched the target in them: forces on average, anything else at all."""
        names = ("qpos", "sensordata") if self.rule.uses_contact_sensors else ("qpos",)
        record = self._batch.rollout(control.shape[1], control, CONTROL_SPEC, record=names, ids=ids)
        qpos = record["qpos"]
        target = qpos[..., self.scene.target_qpos : self.scene.target_qpos + 3]
        distance = np.linalg.norm(target - qpos[..., self.scene.hand_qpos[:PALM_DOF]], axis=-1)
        touch = read_touch(record["sensordata"]) if self.rule.uses_contact_sensors else None
        if touch is not None:
            self.touch[ids] = touch.mean(axis=1)
        return Substeps(self.acting[ids], distance, touch)

    def _center_distance(self) -> np.ndarray:
        return np.linalg.norm(self.target_pose[:, :3] - self.state[:, :PALM_DOF], axis=1)
