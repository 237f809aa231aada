"""N worlds = N rows over one model: reset a row, step all of them, observe them. Everything else
stands on this.
"""

from collections.abc import Sequence

import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.agent import Observation, WorldState
from dynahoi_lerobot.core.conventions import HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.features import TRUTH
from dynahoi_lerobot.core.protocols import one_hot_phase
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.scene.scene import Scene, compile_scene
from dynahoi_lerobot.scene.world_fields import WorldFields
from dynahoi_lerobot.world.commands import Commands
from dynahoi_lerobot.world.physics import Physics
from dynahoi_lerobot.world.sensors import KINEMATICS, Cameras, Fingertips, Stage


class WorldBatch:
    """N simulated worlds that share one compiled model and one clock rate, each at its own frame of
    its own episode.

    Every array below has one row per world. Rows are independent to the bit: what happens in one
    depends neither on its neighbors, nor on the size of the batch, nor on the number of threads.

    Positions are in the *home frame*: axes of the world, origin at the palm's home in this episode.
    The simulation underneath keeps the world frame; this class converts, commands on their way in
    and measurements on their way out.

    Attributes:
        rules, size: as given.
        scene: the compiled model and where things are in it.
        rule: the capture rule.
        control: the control class, whose limits every command is held to.
        commands: reads actions, cuts them and lets them wait.
        given, executed: (N, 18) of ``commands``: the one last given, as it was cut, and what the
            servos were last told.
        cameras: render the worlds.
        specs: the episode of each world, None where none has begun.
        frame: (N,) int, current frame of each world's episode.
        attempt: (N,) int, from 1.
        localized, palm_distance_m, contacts: what `Physics` keeps of the last control step.
    """

    def __init__(self, rules: Rules, size: int, threads: int = 0) -> None:
        """Allocate ``size`` worlds.

        Args:
            rules: how the episodes play and are seen.
            size: N.
            threads: for physics, 0 for all cores; without influence on the result.

        Raises:
            ValueError: if ``size`` is not positive or a name is unknown.
        """
        if size < 1:
            raise ValueError(f"a batch needs at least 1 world, got {size}")
        self.rules = rules
        self.size = size
        self.scene: Scene = compile_scene(rules.hand_name)
        self.rule = rules.capture_rule()
        self.control = rules.control
        self.specs: list[EpisodeSpec | None] = [None] * size
        self.frame = np.zeros(size, int)
        self.attempt = np.ones(size, int)
        self._windows = np.zeros(size, int)  # length of each observation window [frames]
        self._origin = np.zeros((size, HAND_DOF))  # homes [m], world, and zero for the joints
        self._batch = Batch(self.scene.model, nsim=size, nthread=threads)
        self._fields = WorldFields(self._batch, self.scene)
        self.commands = Commands(size, self.scene, self.rule, self.control, rules.control_mode)
        self.given = self.commands.given
        self.executed = self.commands.executed
        self._physics = Physics(self.scene, self._batch, self._fields, self.rule)
        self.localized = self._physics.localized
        self.palm_distance_m = self._physics.palm_distance_m
        self.contacts = self._physics.contacts
        self._fingertips = Fingertips(self.scene, self._batch, self._fields)
        self.cameras = Cameras(self.scene, self._batch, rules, self.specs, self.frame)
        self._threads = threads
        self._stage = None

    def reset(
        self,
        ids: Sequence[int] | np.ndarray,
        specs: Sequence[EpisodeSpec],
        attempt: Sequence[int] | int = 1,
    ) -> None:
        """Begin an episode in each world of ``ids``: target at its start, hand open at home.

        Args:
            ids: sorted, distinct worlds.
            specs: one episode for each.
            attempt: how often each has been begun, for experts that try something else then.
        """
        chosen = np.asarray(ids, int)
        self.frame[chosen] = 0
        self.attempt[chosen] = attempt
        self.cameras.forget(chosen)
        self._fields.reset(chosen)
        for i, spec in zip(chosen, specs, strict=True):
            self._write(int(i), spec)
        self._fields.finish(chosen)
        distance = np.linalg.norm(self.target_pose_h[:, :3] - self.state[:, :PALM_DOF], axis=1)
        self._physics.reset(chosen, distance[chosen])

    def place(self, state: np.ndarray, target_pose_h: np.ndarray) -> None:
        """Pose hands and targets of all worlds without physics, to look at them; what was going on
        there is lost.

        Args:
            state: (N, 18) palm center position [m], home frame, and joint angles [rad].
            target_pose_h: (N, 7) position [m], home frame, and quaternion wxyz.
        """
        first = self.scene.target_qpos
        self._fields.qpos[:, self.scene.hand_qpos] = state + self._origin
        self._fields.qpos[:, first : first + 7] = target_pose_h
        self._fields.qpos[:, first : first + PALM_DOF] += self.home_pos_w
        self._batch.forward(stage=KINEMATICS)

    def step(
        self,
        actions: np.ndarray,
        ids: np.ndarray | None = None,
        control_mode: str | None = None,
    ) -> None:
        """Advance worlds ``ids`` (default: all) by one control step of 0.05 s.

        During the observation window the hand is held at home; commands that would take effect in
        it are void.

        Args:
            actions: (N, 18) palm positions [m], home frame, and joint angles [rad], or (N, 4) in
                control mode ``grasp``; the rows of other worlds are ignored.
            ids: sorted, distinct worlds.
            control_mode: of the actions; by default the rules' own.

        Raises:
            ValueError: for a wrong shape or a value that is not finite; no world moves then.
        """
        chosen = np.arange(self.size) if ids is None else np.asarray(ids, int)
        wanted = self.commands.read(actions, self.state, control_mode)[chosen]
        if not len(chosen):
            return
        set_points = (
            self.commands.follow(chosen, wanted, self.accepting[chosen])
            + self._origin[chosen, None]
        )
        self._physics.advance(chosen, set_points, self.frame[chosen], self.acting[chosen])
        self.frame[chosen] += 1
        self._batch.forward(chosen, stage=KINEMATICS)

    @property
    def acting(self) -> np.ndarray:
        """(N,) bool, the control phase has begun: the hand may move during this frame."""
        return self.frame >= self._windows

    @property
    def accepting(self) -> np.ndarray:
        """(N,) bool, a command given at this frame takes effect in the control phase; earlier ones
        are void.
        """
        return self.frame + self.control.latency_frames >= self._windows

    @property
    def state(self) -> np.ndarray:
        """(N, 18) palm center position [m], home frame, and joint angles [rad], as measured."""
        return self._fields.qpos[:, self.scene.hand_qpos] - self._origin

    @property
    def home_pos_w(self) -> np.ndarray:
        """(N, 3) the origin of each world's home frame [m], world."""
        return self._origin[:, :PALM_DOF].copy()

    @property
    def target_pose_h(self) -> np.ndarray:
        """(N, 7) position [m], home frame, and quaternion wxyz."""
        pose = self._physics.target_pose_h
        pose[:, :PALM_DOF] -= self.home_pos_w
        return pose

    @property
    def target_velocity_w(self) -> np.ndarray:
        """(N, 6) linear [m/s] and angular [rad/s] velocity, along the world's axes."""
        return self._physics.target_velocity_w

    @property
    def visual_state(self) -> np.ndarray:
        """(N, nq + ngeom) all that an image of a world depends on and an episode changes."""
        return self._fields.visual_state

    def tip_frames(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, 5 + S, 12) where fingertips and the target's solids are in worlds ``ids``
        (n,): what ``tip_distance`` and ``fingertips`` compute from, see ``Fingertips.frames``.
        """
        return self._fingertips.frames(ids)

    def tip_distance(self, i: int, tip_frames: np.ndarray) -> np.ndarray:
        """Return (T, 5), signed distance of each fingertip to the surface of the target of world
        ``i`` [m], negative inside, at (T, 5 + S, 12) ``tip_frames``.
        """
        return self._fingertips.target_distance(i, tip_frames)

    def fingertips(self, i: int, tip_frames: np.ndarray) -> np.ndarray:
        """Return (T, 30), position [m], home frame of world ``i``, and rotation vector [rad] of
        each fingertip at (T, 5 + S, 12) ``tip_frames``.
        """
        return self._fingertips.poses(tip_frames, self.home_pos_w[i])

    def observe(self, *, images: bool = True, ids: np.ndarray | None = None) -> Observation:
        """Return what a policy may see.

        Args:
            images: whether to render the views of the rules; without, they cost nothing.
            ids: the worlds to render (default: all); the images of the others are black, as are
                the images of worlds in the control phase of a protocol with ``blind_control``.
        """
        seen = np.arange(self.size) if ids is None else ids
        state = self.state
        shown = self.cameras.images(seen) if images and self.rules.image_size else {}
        truth = self.rules.environment_state == TRUTH
        return Observation(
            images=shown,
            state=state.astype(np.float32),
            phase=one_hot_phase(self.accepting),
            tasks=tuple("" if spec is None else spec.task for spec in self.specs),
            touch=self.contacts.finger_force_n.astype(np.float32)
            if self.rule.uses_contact_sensors
            else None,
            environment_state=np.hstack([self.target_pose_h, self.target_velocity_w]).astype(
                np.float32
            )
            if truth
            else None,
            sighting=self.cameras.sighting(shown, state[:, :PALM_DOF], seen),
        )

    @property
    def renders_later(self) -> bool:
        """Whether images can be rendered once an episode has ended, by ``images_of``."""
        return self.rules.image_size > 0 and not self.cameras.in_order

    def images_of(self, i: int, visual_states: np.ndarray) -> dict[str, np.ndarray]:
        """Return the views of world ``i`` in the first T frames of its episode, of which
        (T, nq + ngeom) ``visual_states`` were recorded.

        They are (T, H, W, 3) uint8, the same that ``observe`` would have shown.
        """
        spec = self.specs[i]
        assert spec is not None, "no episode has begun"
        self._stage = self._stage or Stage(self.scene, self.rules, self._threads)
        return self._stage.images(self._fields, i, spec, visual_states)

    def world_state(self, observation: Observation, ids: np.ndarray | None = None) -> WorldState:
        """Return what an expert sees: the observation and everything the simulator knows, with the
        episodes of worlds ``ids`` (n,) (default: all) alone.
        """
        used = set(range(self.size) if ids is None else ids.tolist())
        return WorldState(
            observation=observation,
            specs=tuple(spec if i in used else None for i, spec in enumerate(self.specs)),
            frame=self.frame.copy(),
            attempt=self.attempt.copy(),
            target_pose_h=self.target_pose_h,
            target_velocity_w=self.target_velocity_w,
            localized=self.localized.copy(),
            control=self.control,
            localization_radius_m=self.rule.localization_radius_m,
            state_when_due=self.commands.when_due.copy(),
        )

    def _write(self, i: int, spec: EpisodeSpec) -> None:
        """Fill row ``i`` with an episode that is about to begin."""
        self._physics.drive(
            i, self._fields.write_episode(i, spec, self.rule.collisions(spec.motion))
        )
        # rounded as commands are, or the hand would creep and, by rounding, disturb what slides or
        # rests
        rest = np.concatenate([np.zeros(PALM_DOF), self.scene.hand.open_joints()]).astype(
            np.float32
        )
        self._origin[i, :PALM_DOF] = spec.home_pos_w
        self.commands.begin(i, rest, self._origin[i])
        self._fields.qpos[i, self.scene.hand_qpos] = rest + self._origin[i]
        self.specs[i] = spec
        self._windows[i] = spec.window_frames
