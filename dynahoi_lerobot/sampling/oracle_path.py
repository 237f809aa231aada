"""Where a target goes if nobody touches it: roll the untouched world ahead."""

from collections import defaultdict
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.conventions import CONTROL_HZ, SUBSTEPS
from dynahoi_lerobot.motions import Motion, PhysicalMotion
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.scene.model import ENVIRONMENT
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.scene.world_fields import WorldFields

LIKE_LENGTH_FRAMES = 16
"""Paths whose lengths differ by less roll together; a throw must not wait for a pendulum ten times as long."""
PARKED_PALM_W = (0.0, 0.0, 1.0)
"""Anywhere within the gantry's reach: hand and target do not collide here."""
CONTROL_SPEC = mujoco.mjtState.mjSTATE_QFRC_APPLIED


def roll_ahead(
    motions: Sequence[Motion],
    targets: Sequence[TargetObject],
    frames: Sequence[int],
    *,
    hand: str = "capsule",
    threads: int = 1,
) -> list[np.ndarray]:
    """Return the path of each untouched target.

    Prescribed targets follow their closed form, which the simulated drive reproduces; physical ones are simulated in
    the scene they will be played in, with the hand parked. A target at which nothing pushes then goes the very same
    way to the bit; in a scene without a hand, sliding ones would drift apart by centimetres.

    Args:
        motions, targets: N worlds.
        frames: how many frames of each are wanted.
        hand: the embodiment of the scene.
        threads: for the simulation; the result does not depend on it.

    Returns:
        N arrays (F, 3) of positions [m], world, 0.05 s apart, the first at t = 0.
    """
    paths: list[np.ndarray] = [np.empty(0)] * len(motions)
    groups: dict[int, list[int]] = defaultdict(list)
    for i, motion in enumerate(motions):
        if isinstance(motion, PhysicalMotion):
            groups[frames[i] // LIKE_LENGTH_FRAMES].append(i)
        else:
            paths[i] = motion.position(np.arange(frames[i]) / CONTROL_HZ)  # type: ignore[attr-defined]
    for ids in groups.values():
        longest = max(frames[i] for i in ids)
        rolled = _simulate([motions[i] for i in ids], [targets[i] for i in ids], longest, hand, threads)
        for i, path in zip(ids, rolled, strict=True):
            paths[i] = path[: frames[i]]
    return paths


def _simulate(
    motions: Sequence[Motion], targets: Sequence[TargetObject], frames: int, hand: str, threads: int
) -> np.ndarray:
    """(N, frames, 3) positions of physical targets."""
    scene = compile_scene(hand)
    batch = Batch(scene.model, nsim=len(motions), nthread=threads)
    rows, ids = WorldFields(batch, scene), np.arange(len(motions))
    rows.reset(ids)
    forces = [rows.write_world(i, motion, targets[i], frames - 1, ENVIRONMENT) for i, motion in enumerate(motions)]
    parked = np.concatenate([PARKED_PALM_W, scene.hand.open_joints()])
    rows.qpos[:, scene.hand_qpos] = batch.bind("ctrl")[:] = parked
    rows.finish(ids)
    start = rows.qpos[:, scene.target_qpos : scene.target_qpos + 3].copy()
    control = np.zeros((len(motions), (frames - 1) * SUBSTEPS, scene.model.nv))
    control[..., scene.target_dof : scene.target_dof + 3] = [force.reshape(-1, 3) for force in forces]
    record = batch.rollout(control.shape[1], control, CONTROL_SPEC.value, record=("qpos",))
    path = record["qpos"][:, SUBSTEPS - 1 :: SUBSTEPS, scene.target_qpos : scene.target_qpos + 3]
    return np.concatenate([start[:, None], path], axis=1)
