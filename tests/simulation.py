"""Motions without a hand: as the sampler draws them, and their real dynamics at 500 Hz."""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.conventions import CONTROL_DT, PHYSICS_DT, SUBSTEPS
from dynahoi_lerobot.motions import MOTIONS, Draw, Motion
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.target_path import PARKED_PALM_W
from dynahoi_lerobot.sampling.timing import draw_timing
from dynahoi_lerobot.scene.model import ENVIRONMENT
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.scene.world_fields import WorldFields


@dataclass(frozen=True)
class Drawn:
    """One motion and its target, and for how long the motion must make sense [s]."""

    motion: Motion
    target: TargetObject
    horizon_s: float


def draw_motion(kind: str, seed: int, object_name: str | None = None) -> Drawn:
    """Draw a motion of ``kind`` with the timing of a sampled episode."""
    rng = np.random.default_rng([seed, 7])
    timing = draw_timing(kind, "observe_before_act", rng)
    allowed = [
        name for name in BENCHMARK.splits["train"].objects if MOTIONS[kind].suits(OBJECTS[name])
    ]
    name = object_name or str(rng.choice(allowed))
    target = OBJECTS[name].sample(rng)
    window_s = timing.window_frames * CONTROL_DT
    draw = Draw(
        rng=rng,
        target=target,
        window_s=window_s,
        intercept_s=window_s + timing.approach_frames * CONTROL_DT,
        horizon_s=(timing.window_frames + timing.length_frames) * CONTROL_DT,
        speed_scale=1.0,
    )
    return Drawn(MOTIONS[kind].sample(draw), target, draw.horizon_s)


@dataclass(frozen=True)
class Track:
    """What target and striker did, one row per physics step.

    Attributes:
        time: (K,) [s]; ``pos``: (K, 3) [m]; ``velocity``: (K, 3) [m/s]; ``quat``: (K, 4) wxyz,
            world.
        spin: (K, 3) angular velocity [rad/s], target frame.
        striker_speed: (K,) [m/s] along its slide.
    """

    time: np.ndarray
    pos: np.ndarray
    velocity: np.ndarray
    quat: np.ndarray
    spin: np.ndarray
    striker_speed: np.ndarray


def simulate(
    motion: Motion, target: TargetObject, seconds: float, driven_frames: int | None = None
) -> Track:
    """Let ``target`` perform ``motion`` with nobody near; what drives it may stop after some
    frames.
    """
    scene = compile_scene()
    batch = Batch(scene.model, nsim=1, nthread=1)
    rows = WorldFields(batch, scene)
    one = np.array([0])
    frames = int(np.ceil(seconds * 20))
    rows.reset(one)
    force_w = rows.write_world(0, motion, target, frames, ENVIRONMENT)
    rows.qpos[:, scene.hand_qpos] = batch.bind("ctrl")[:] = np.concatenate(
        [PARKED_PALM_W, scene.hand.open_joints()]
    )
    rows.finish(one)
    force = np.zeros((1, frames * SUBSTEPS, scene.model.nv))
    force[0, :, scene.target_dof : scene.target_dof + 3] = force_w.reshape(-1, 3)
    force[0, frames * SUBSTEPS if driven_frames is None else driven_frames * SUBSTEPS :] = 0.0
    first_qpos = rows.qpos[0].copy()
    first_qvel = rows.qvel[0].copy()
    applied = mujoco.mjtState.mjSTATE_QFRC_APPLIED.value
    record = batch.rollout(force.shape[1], force, applied, record=("qpos", "qvel"))
    assert not np.any(batch.warning), "the simulation is unstable"
    qpos = np.vstack([first_qpos, record["qpos"][0]])
    qvel = np.vstack([first_qvel, record["qvel"][0]])
    at = scene.target_qpos
    dof = scene.target_dof
    return Track(
        time=np.arange(len(qpos)) * PHYSICS_DT,
        pos=qpos[:, at : at + 3],
        velocity=qvel[:, dof : dof + 3],
        quat=qpos[:, at + 3 : at + 7],
        spin=qvel[:, dof + 3 : dof + 6],
        striker_speed=qvel[:, scene.striker_dof],
    )
