"""The hand waits where it can watch its target, and near no table, ramp or wall."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.sampling.homes import REFERENCE_HAND, keeps_clear
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene.scene import compile_scene

KINDS = ("ramp", "ramp_and_runout", "struck", "wall_rebound")
"""Those with fixtures near the hand; a bounce has a floor."""
HAND_CLEARANCE_M = 0.011
FAR_M = 1.0


def boxes_of(spec: EpisodeSpec) -> tuple[Box, ...]:
    """The boxes around the motion of an episode."""
    return spec.motion.launch(spec.target).boxes


class Bystander:
    """The open reference hand at a place of one's choice, beside the boxes of an episode."""

    def __init__(self, spec: EpisodeSpec) -> None:
        scene = compile_scene(REFERENCE_HAND)
        self.scene = copy.copy(scene)
        self.scene.model = copy.copy(scene.model)  # sizes are written below, and others share it
        self.data = mujoco.MjData(self.scene.model)
        self.data.mocap_pos[list(self.scene.box_mocap)] = (0.0, 0.0, -50.0)
        self.boxes = self.scene.box_geoms[: len(boxes_of(spec))]
        for box, geom, mocap in zip(boxes_of(spec), self.boxes, self.scene.box_mocap, strict=False):
            self.scene.model.geom_size[geom] = box.half_size
            self.data.mocap_pos[mocap], self.data.mocap_quat[mocap] = box.pos, box.quat

    def hand_distance(self, palm_w: np.ndarray) -> float:
        """Least distance of any part of the hand from a box [m]."""
        self.data.qpos[self.scene.hand_qpos] = [*palm_w, *self.scene.hand.open_joints()]
        mujoco.mj_kinematics(self.scene.model, self.data)
        return min(self._distance(int(part), geom) for part in self.scene.hand_geoms for geom in self.boxes)

    def _distance(self, one: int, other: int) -> float:
        return mujoco.mj_geomDistance(self.scene.model, self.data, one, other, FAR_M, None)


def test_no_hand_waits_near_a_fixture():
    """Of homes that were not checked, 21 of 440 had the palm inside a box or within 3 cm of it."""
    for spec in sample_specs(Recipe(motions=KINDS), range(120)):
        distance = Bystander(spec).hand_distance(spec.home_pos_w)
        assert distance >= HAND_CLEARANCE_M, f"{spec.motion.name} of seed {spec.seed}"


def test_homes_beside_a_table():
    """A table 2 cm below the target: from above is free, from below and through its edge is not."""
    table = Box((0.0, 0.0, 1.0), (0.5, 0.5, 0.02))
    intercept = np.array([0.0, 0.0, 1.04])
    homes = np.array([[-0.2, 0.0, 1.3], [-0.2, 0.0, 0.7], [-0.7, 0.0, 0.95], [-0.2, 0.0, 1.06]])
    np.testing.assert_array_equal(keeps_clear(homes, intercept, [table]), [True, False, False, False])
    assert keeps_clear(homes, intercept, []).all()
