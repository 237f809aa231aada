"""Where a target goes if nobody touches it: roll the untouched world ahead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.conventions import CONTROL_HZ, SUBSTEPS
from dynahoi_lerobot.motions import Motion, PhysicalMotion
from dynahoi_lerobot.scene.model import ENVIRONMENT
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.scene.world_fields import WorldFields

if TYPE_CHECKING:
    from dynahoi_lerobot.sampling.sampler import Candidate

PARKED_PALM_W = (0.0, 0.0, 1.0)
"""Anywhere within the gantry's reach: hand and target do not collide here."""
APPLIED_FORCES = mujoco.mjtState.mjSTATE_QFRC_APPLIED


class RollAhead:
    """The untouched targets of candidates, whose paths are known as far as they have been asked
    for.

    Prescribed targets follow their closed form, which the simulated drive reproduces; physical ones
    are simulated in the scene they will be played in, with the hand parked. A target at which
    nothing pushes then goes the very same way to the bit; in a scene without a hand, sliding ones
    would drift apart by centimeters.
    """

    def __init__(self, hand: str, threads: int) -> None:
        """Roll no target yet.

        Args:
            hand: the embodiment of the scene.
            threads: for the simulation; the result does not depend on it.
        """
        self._scene = compile_scene(hand)
        self._threads = threads
        self._candidates: Mapping[int, Candidate] = {}
        self._rows: dict[int, int] = {}
        self._batch: Batch | None = None

    def place(self, candidates: Mapping[int, Candidate]) -> None:
        """Put the targets of the motions last drawn, of numbered candidates, where they start, and
        forget those before.
        """
        self._candidates = candidates
        # a simulated target has one motion: gravity cannot be scaled
        physical = [i for i, c in candidates.items() if isinstance(c.motions[0], PhysicalMotion)]
        self._rows = {i: row for row, i in enumerate(physical)}
        if not physical:
            return
        batch, fields = self._room(len(physical))
        scene = self._scene
        rows = np.arange(len(physical))
        fields.reset(rows)
        self._force_w = []
        for i, row in self._rows.items():
            candidate = candidates[i]
            (motion,) = candidate.motions
            last = candidate.timing.path_frames - 1
            force_w = fields.write_world(row, motion, candidate.target, last, ENVIRONMENT)
            self._force_w.append(force_w)
        parked = np.concatenate([PARKED_PALM_W, scene.hand.open_joints()])
        fields.qpos[:, scene.hand_qpos] = batch.bind("ctrl")[:] = parked
        fields.finish(rows)
        self._position = slice(scene.target_qpos, scene.target_qpos + 3)
        self._paths_w = list(fields.qpos[rows, None, self._position].copy())

    def paths(self, frames: Mapping[int, int]) -> dict[int, list[np.ndarray]]:
        """Return the paths of some candidates over the wanted numbers of frames F, which are
        simulated once.

        Returns:
            (F, 3) positions [m], world, 0.05 s apart, the first at t = 0, for each motion.
        """
        self._simulate({self._rows[i]: wanted for i, wanted in frames.items() if i in self._rows})
        return {i: self._paths_of(i, wanted) for i, wanted in frames.items()}

    def _paths_of(self, i: int, frames: int) -> list[np.ndarray]:
        if i in self._rows:
            return [self._paths_w[self._rows[i]][:frames]]
        times = np.arange(frames) / CONTROL_HZ
        return [_path(motion, times) for motion in self._candidates[i].motions]

    def _simulate(self, wanted: dict[int, int]) -> None:
        """Roll rows of the batch until so many frames of each are known, in each call as far as all
        of them go.
        """
        while True:
            missing = {row: n - len(self._paths_w[row]) for row, n in wanted.items()}
            rows = np.array(sorted(row for row, more in missing.items() if more > 0), int)
            if not len(rows):
                return
            frames = min(missing[row] for row in rows)
            control = np.zeros((len(rows), frames * SUBSTEPS, self._scene.model.nv))
            dof = self._scene.target_dof
            for k, row in enumerate(rows):
                first = len(self._paths_w[row]) - 1
                control[k, :, dof : dof + 3] = self._force_w[row][first : first + frames].reshape(
                    -1, 3
                )
            assert self._batch is not None, "place targets first"
            record = self._batch.rollout(
                control.shape[1], control, APPLIED_FORCES.value, record=("qpos",), ids=rows
            )
            for row, qpos in zip(rows, record["qpos"][:, SUBSTEPS - 1 :: SUBSTEPS], strict=True):
                self._paths_w[row] = np.concatenate([self._paths_w[row], qpos[:, self._position]])

    def _room(self, rows: int) -> tuple[Batch, WorldFields]:
        """Return a batch of at least so many rows, which earlier targets may have used, and its
        fields.
        """
        if self._batch is None or self._batch.nsim < rows:
            self._batch = Batch(self._scene.model, nsim=rows, nthread=self._threads)
            self._fields = WorldFields(self._batch, self._scene)
        return self._batch, self._fields


def _path(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Return where a prescribed motion is at ``times`` (K,) [s], (K, 3) [m], world.

    Raises:
        ValueError: if the motion returns positions of another shape.
    """
    positions: np.ndarray = motion.position(times)  # type: ignore[attr-defined]
    if positions.shape != (len(times), 3):
        raise ValueError(
            f"motion {motion.name!r} must return positions of shape {(len(times), 3)}, got "
            f"{positions.shape}"
        )
    return positions
