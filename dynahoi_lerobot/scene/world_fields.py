"""Writing one episode into one row of a batch: geometry, masses, fixtures, state and appearance."""

from itertools import zip_longest
from typing import Self

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.conventions import PHYSICS_DT, SUBSTEPS
from dynahoi_lerobot.core.numerics import arctan2, norm
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.motions import Motion, PrescribedMotion
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, Box, Launch, Striker, Vector, yaw_quat
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.scene.appearance import Appearance, Solid
from dynahoi_lerobot.scene.model import HIDDEN_POS, impact_solref
from dynahoi_lerobot.scene.scene import Scene

HIDDEN_SIZE = (1e-4, 1e-4, 1e-4)
FIELDS = (
    "body_inertia",
    "body_mass",
    "body_pos",
    "body_quat",
    "dof_damping",
    "eq_data",
    "geom_contype",
    "geom_friction",
    "geom_matid",
    "geom_pos",
    "geom_quat",
    "geom_rgba",
    "geom_size",
    "geom_solref",
    "light_diffuse",
    "light_dir",
    "light_specular",
)
"""Model fields that differ between worlds."""
GRAVITY_W = np.array([0.0, 0.0, -GRAVITY_M_S2])


class WorldFields:
    """The per-world fields of a batch, by name, and how to fill them."""

    def __init__(self, batch: Batch, scene: Scene) -> None:
        """Expand the fields of ``batch``, which runs ``scene.model``."""
        self._batch = batch
        self._scene = scene
        self.fields = {name: batch.expand(name) for name in FIELDS}
        self.qpos = batch.bind("qpos")
        self.qvel = batch.bind("qvel")
        self._mocap_pos = batch.bind("mocap_pos")
        self._mocap_quat = batch.bind("mocap_quat")
        self.eq_active = batch.bind("eq_active")
        self._anchors = np.zeros((batch.nsim, 6))

    def reset(self, ids: np.ndarray) -> None:
        """Reset worlds without computing anything; the writes that follow need ``finish``."""
        self._batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE.value)

    @property
    def visual_state(self) -> np.ndarray:
        """(N, nq + ngeom) what changes the look of the worlds while an episode is played: MuJoCo's
        configuration, and the opacity of every geom, since a string is invisible once it is cut.
        """
        return np.hstack([self.qpos, self.fields["geom_rgba"][..., 3]])

    def copy(self, other: Self, i: int, visual_state: np.ndarray) -> np.ndarray:
        """Make the first rows look like row ``i`` of ``other`` in n ``visual_state``,
        (n, nq + ngeom); return (n,) their numbers.

        It needs ``forward`` then; what a simulation would need besides is not copied.
        """
        rows = slice(len(visual_state))
        for name, values in self.fields.items():
            values[rows] = other.fields[name][i]
        self._mocap_pos[rows] = other._mocap_pos[i]
        self._mocap_quat[rows] = other._mocap_quat[i]
        self.qpos[rows], self.fields["geom_rgba"][rows, :, 3] = np.split(
            visual_state, [self.qpos.shape[1]], axis=1
        )
        return np.arange(len(visual_state))

    def finish(self, ids: np.ndarray) -> None:
        """Recompute what depends on the written masses and positions, then the kinematics."""
        self._batch.set_const(ids)
        self.fields["eq_data"][ids, self._scene.tether_eq, :6] = self._anchors[
            ids
        ]  # set_const moved the anchors
        self._batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_POS.value)

    def write_world(
        self, i: int, motion: Motion, target: TargetObject, frames: int, collides_with: int
    ) -> np.ndarray:
        """Fill row ``i`` with a target about to move; the row must have been reset.

        Args:
            i: the world.
            motion: how the target moves.
            target: the object.
            frames: for which it is driven, F.
            collides_with: collision bits the target asks for.

        Returns:
            (F, 25, 3) force [N] that drives it, see ``drive_for``.
        """
        launch, (start_pos_w, start_velocity_w, force_w) = (
            motion.launch(target),
            drive_for(motion, target, frames),
        )
        self._write_target(i, target, launch, collides_with)
        for slot in range(len(self._scene.box_geoms)):
            self._write_box(i, slot, launch.boxes[slot] if slot < len(launch.boxes) else None)
        self._write_tether(i, launch.tether, np.asarray(launch.pos))
        self._write_striker(i, launch.striker)
        qpos = self._scene.target_qpos
        dof = self._scene.target_dof
        self.qpos[i, qpos : qpos + 3] = start_pos_w
        self.qpos[i, qpos + 3 : qpos + 7] = launch.quat
        self.qvel[i, dof : dof + 3] = start_velocity_w
        self.qvel[i, dof + 3 : dof + 6] = launch.spin
        self.fields["dof_damping"][i, dof : dof + 3] = launch.drag_kg_s
        return force_w

    def write_episode(self, i: int, spec: EpisodeSpec, collides_with: int) -> np.ndarray:
        """Fill row ``i`` with an episode but for its hand; the row must have been reset. See
        ``write_world``.
        """
        force_w = self.write_world(i, spec.motion, spec.target, spec.horizon_frames, collides_with)
        if isinstance(spec.motion, PrescribedMotion):
            qpos = self._scene.target_qpos
            dof = self._scene.target_dof
            self.qpos[i, qpos + 3 : qpos + 7] = yaw_quat(spec.yaw_rad)
            self.qvel[i, dof + 5] = spec.spin_rad_s
        self._write_appearance(i, spec.appearance)
        self._mocap_pos[i, self._scene.side_mocap] = spec.home_pos_w
        return force_w

    def _write_appearance(self, i: int, appearance: Appearance) -> None:
        scene = self._scene
        rgba = self.fields["geom_rgba"]
        matid = self.fields["geom_matid"]
        painted = (
            (scene.target_geoms, appearance.target_pattern + "_thing", appearance.target_rgb),
            ([scene.floor_geom], appearance.floor_pattern + "_floor", appearance.floor_rgb),
            (scene.wall_geoms, appearance.wall_pattern + "_wall", appearance.wall_rgb),
            (scene.box_geoms, appearance.box_pattern + "_thing", appearance.box_rgb),
        )
        for geoms, material, rgb in painted:
            for geom in geoms:
                matid[i, geom] = scene.materials[material]
                rgba[i, geom, :3] = rgb
        rgba[i, np.concatenate([scene.hand_geoms, scene.skin_geoms]), :3] = appearance.skin_rgb
        rgba[i, scene.sleeve_geoms, :3] = appearance.sleeve_rgb
        self.fields["light_dir"][i, 0] = np.asarray(appearance.light_dir) / norm(
            appearance.light_dir
        )
        self.fields["light_diffuse"][i, 0] = appearance.light_level * np.asarray(
            appearance.light_rgb
        )
        self.fields["light_specular"][i, 0] = appearance.gloss
        shown = scene.target_geoms[rgba[i, scene.target_geoms, 3] > 0]
        rgba[i, shown, 3] = appearance.target_alpha
        things = {thing.shape: thing for thing in appearance.distractors}
        for shape, geom in scene.distractor_geoms.items():
            self._write_solid(i, geom, things.get(shape))
        for geom, solid in zip_longest(scene.furniture_geoms, appearance.furniture):
            self._write_solid(i, geom, solid)
        self._write_solid(i, scene.screen_geom, appearance.screen)

    def _write_solid(self, i: int, geom: int, solid: Solid | None) -> None:
        self.fields["geom_size"][i, geom] = HIDDEN_SIZE if solid is None else solid.half_size
        self.fields["geom_pos"][i, geom] = HIDDEN_POS if solid is None else solid.pos_w
        self.fields["geom_quat"][i, geom] = (1.0, 0.0, 0.0, 0.0)
        self.fields["geom_rgba"][i, geom] = (0.0,) * 4 if solid is None else (*solid.rgb, 1.0)

    def free_target(self, i: int) -> None:
        """Cut the tether of world ``i``."""
        self.eq_active[i, self._scene.tether_eq] = 0
        self.fields["geom_rgba"][i, self._scene.tether_geom, 3] = 0.0

    def set_collisions(self, i: int, collides_with: int) -> None:
        """Let the visible solids of the target in world ``i`` ask for these collision bits."""
        geoms = self._scene.target_geoms
        visible = self.fields["geom_rgba"][i, geoms, 3] > 0
        self.fields["geom_contype"][i, geoms] = np.where(visible, collides_with, 0)

    def _write_target(
        self, i: int, target: TargetObject, launch: Launch, collides_with: int
    ) -> None:
        fields = self.fields
        geoms = self._scene.target_geoms
        fields["geom_size"][i, geoms] = HIDDEN_SIZE
        fields["geom_pos"][i, geoms] = 0.0
        fields["geom_rgba"][i, geoms, 3] = 0.0
        for geom, primitive in zip(self._scene.slots_of(target), target.primitives, strict=True):
            fields["geom_size"][i, geom] = primitive.half_size
            fields["geom_pos"][i, geom] = primitive.pos
            fields["geom_quat"][i, geom] = primitive.quat
            fields["geom_rgba"][i, geom, 3] = 1.0
        fields["geom_friction"][i, geoms, 0] = (
            target.friction if launch.friction is None else launch.friction
        )
        fields["geom_friction"][i, self._scene.hand_geoms, 0] = (
            target.friction
        )  # of two frictions the greater counts
        fields["geom_solref"][i, geoms] = impact_solref(launch.restitution)
        fields["body_mass"][i, self._scene.target_body] = target.mass_kg
        fields["body_inertia"][i, self._scene.target_body] = target.inertia
        self.set_collisions(i, collides_with)

    def _write_box(self, i: int, slot: int, box: Box | None) -> None:
        geom = self._scene.box_geoms[slot]
        mocap = self._scene.box_mocap[slot]
        self._mocap_pos[i, mocap] = HIDDEN_POS if box is None else box.pos
        self._mocap_quat[i, mocap] = (1.0, 0.0, 0.0, 0.0) if box is None else box.quat
        self.fields["geom_size"][i, geom] = HIDDEN_SIZE if box is None else box.half_size
        if box is not None:
            self.fields["geom_solref"][i, geom] = impact_solref(box.restitution)
            self.fields["geom_friction"][i, geom, 0] = box.friction
        self.fields["geom_rgba"][i, geom, 3] = float(box is not None)

    def _write_tether(self, i: int, anchor: Vector | None, start: np.ndarray) -> None:
        geom = self._scene.tether_geom
        eq = self._scene.tether_eq
        self.eq_active[i, eq] = anchor is not None
        self.fields["geom_rgba"][i, geom, 3] = float(anchor is not None)
        length = 0.0 if anchor is None else norm(np.asarray(anchor) - start)
        self.fields["geom_pos"][i, geom] = (0, 0, length / 2)
        self.fields["geom_quat"][i, geom] = (1, 0, 0, 0)
        self.fields["geom_size"][i, geom, 1] = max(length / 2, 1e-4)
        self._anchors[i] = np.zeros(6) if anchor is None else (0.0, 0.0, length, *anchor)

    def _write_striker(self, i: int, striker: Striker | None) -> None:
        body = self._scene.striker_body
        geom = self._scene.striker_geom
        self.fields["geom_rgba"][i, geom, 3] = float(striker is not None)
        if striker is None:
            self.fields["body_pos"][i, body] = HIDDEN_POS
            return
        velocity = np.asarray(striker.velocity)
        yaw = float(arctan2(velocity[1], velocity[0]))
        self.fields["body_pos"][i, body], self.fields["body_quat"][i, body] = (
            striker.pos,
            yaw_quat(yaw),
        )
        self.fields["geom_size"][i, geom, 0] = striker.radius_m
        self.fields["geom_solref"][i, geom] = impact_solref(striker.restitution)
        self.fields["body_mass"][i, body] = striker.mass_kg
        self.qvel[i, self._scene.striker_dof] = norm(velocity)


def drive_for(
    motion: Motion, target: TargetObject, frames: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how ``target`` starts, and the force that keeps it on the path of ``motion`` for F
    frames.

    This is discrete inverse dynamics, exact at every physics step. A prescribed target is an
    ordinary free body under an applied force. Semi-implicit Euler advances v' = v + h (F / m + g),
    x' = x + h v', so F = m ((x'' - 2 x' + x) / h^2 - g) reproduces the path to rounding error. To
    let go of the target is to stop applying the force: no jump in position or velocity.

    Returns:
        (3,) position [m] and (3,) velocity [m/s] at t = 0, world; and (F, 25, 3) applied force [N],
        world, in every physics step of every frame, zero where the target is free, apart from the
        impulse that releases it.
    """
    if isinstance(motion, PrescribedMotion):
        times = (
            np.arange(-1, frames * SUBSTEPS + 1) * PHYSICS_DT
        )  # from one physics step before the start
        path = motion.position(times)
        velocities = np.diff(path, axis=0) / PHYSICS_DT
        force = target.mass_kg * (np.diff(velocities, axis=0) / PHYSICS_DT - GRAVITY_W)
        return path[1], velocities[0], force.reshape(frames, SUBSTEPS, 3)
    launch = motion.launch(target)
    start = np.asarray(launch.pos)
    velocity = np.asarray(launch.velocity)
    held = min(round(launch.release_s / PHYSICS_DT), frames * SUBSTEPS)
    if held == 0:
        return start, velocity, np.zeros((frames, SUBSTEPS, 3))
    force = np.zeros((frames * SUBSTEPS, 3))
    force[:held] = -target.mass_kg * GRAVITY_W
    force[held : held + 1] = (
        target.mass_kg * velocity / PHYSICS_DT
    )  # the impulse of letting go, in the first free step
    return start, np.zeros(3), force.reshape(frames, SUBSTEPS, 3)
