"""The Sharpa Wave, a robot's five-fingered hand, from the user's copy of MuJoCo Menagerie.

Its abduction and metacarpal joints stay at zero, so fifteen flexion joints remain, and with the gantry the same
eighteen degrees of freedom as the bundled hands. What collides is also what is drawn: the model's own capsules and
cylinders, and the boxes around its palm's convex pieces; so no mesh has to be rendered.
"""

import os
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGERS, JOINT_NAMES
from dynahoi_lerobot.hands.base import (
    FINGER_BANDWIDTH_RAD_S,
    HAND_GEOM_PREFIX,
    HANDS,
    Hand,
    add_palm,
    add_servo,
    quat_z_to,
)

MENAGERIE_ROOT = "MENAGERIE_ROOT"
"""Environment variable with the folder of MuJoCo Menagerie."""
CACHE = Path.home() / ".cache" / "robot_descriptions" / "mujoco_menagerie"
"""Where the package robot_descriptions keeps it."""
MODEL = "sharpa_wave/left_hand.xml"
"""Its fingers, thumb and palm lie as the bundled hands' do."""

SIDE, WRIST = "left_", 1
"""Its names begin with the first; the second is the number of the body that the fingers grow from."""
FLEXIONS = {
    "thumb": ("thumb_CMC_FE", "thumb_MCP_FE", "thumb_IP"),
    "index": ("index_MCP_FE", "index_PIP", "index_DIP"),
    "middle": ("middle_MCP_FE", "middle_PIP", "middle_DIP"),
    "ring": ("ring_MCP_FE", "ring_PIP", "ring_DIP"),
    "little": ("pinky_MCP_FE", "pinky_PIP", "pinky_DIP"),
}
"""The joints that move, from the palm outwards, in the names of the model."""
JOINTS = dict(zip((joint for finger in FINGERS for joint in FLEXIONS[finger]), JOINT_NAMES, strict=True))
"""Our names of these joints."""
TIPS = {finger: f"{joints[0].split('_')[0]}_fingertip" for finger, joints in FLEXIONS.items()}

WRIST_POS_M = (-0.046, -0.0835, 0.0)
WRIST_QUAT = (np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0)
"""The wrist in the palm's frame: the model's fingers point along its z and its palm along its x."""
IDLE_RANGE_RAD = -0.05
"""Joints may open a little further than straight, or the straight finger would lie at a limit in every step."""
LIGHTEST_LINK_KG, LEAST_INERTIA = 1e-3, 1e-7
SKIN = (0.79, 0.82, 0.93, 1.0)


@HANDS.register("sharpa")
class SharpaHand(Hand):
    """The Sharpa Wave of MuJoCo Menagerie, on the gantry, with its own torque limits; for the rule ``attach``."""

    full_closure_rad: ClassVar = {
        finger: (1.0, 0.9, 0.8) if finger == "thumb" else (1.15, 1.35, 1.0) for finger in FINGERS
    }

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add palm, fingers, servos, sites and the ego camera to ``spec``.

        Raises:
            ValueError: if there is no Menagerie; the message says where it was looked for.
        """
        model = mujoco.MjModel.from_xml_path(str(menagerie_model_path()))
        palm = add_palm(spec, float(model.body_mass[WRIST + 1 :].sum()))
        wrist = palm.add_frame(pos=WRIST_POS_M, quat=WRIST_QUAT)
        bodies = {WRIST: palm}
        for geom in _add_geoms(palm, model, WRIST, "palm"):
            geom.set_frame(wrist)
        for i in range(WRIST + 1, model.nbody):
            parent = int(model.body_parentid[i])
            bodies[i] = _add_body(bodies[parent], model, i)
            if parent == WRIST:
                bodies[i].name = f"{_finger_of(model, i)}_base"
                bodies[i].set_frame(wrist)
        for joint, name in JOINTS.items():
            source = model.joint(SIDE + joint)
            inertia = float(model.dof_armature[source.dofadr[0]])
            add_servo(spec, name, inertia, FINGER_BANDWIDTH_RAD_S, float(model.jnt_actfrcrange[source.id, 1]))


def _add_body(parent: mujoco.MjsBody, model: mujoco.MjModel, i: int) -> mujoco.MjsBody:
    """Add body ``i`` of the model with its inertia, its joint if it is one that flexes, its geoms and its tip."""
    finger, name = _finger_of(model, i), model.body(i).name
    body = parent.add_body(name=name, pos=model.body_pos[i], quat=model.body_quat[i], gravcomp=1.0)
    body.explicitinertial = True
    body.mass = max(float(model.body_mass[i]), LIGHTEST_LINK_KG)
    body.ipos, body.iquat = model.body_ipos[i], model.body_iquat[i]
    body.inertia = np.maximum(model.body_inertia[i], LEAST_INERTIA)
    for joint in np.flatnonzero(model.jnt_bodyid == i):
        _add_flexion(body, model, int(joint))
    _add_geoms(body, model, i, f"{finger}_{name}")
    for site in np.flatnonzero(model.site_bodyid == i):
        if model.site(site).name == SIDE + TIPS[finger]:
            body.add_site(name=f"{finger}_tip", pos=model.site_pos[site], quat=quat_z_to(np.array([1.0, 0.0, 0.0])))
    return body


def _add_flexion(body: mujoco.MjsBody, model: mujoco.MjModel, joint: int) -> None:
    """Add a joint that flexes, turned so that positive angles close; other joints stay as they are at zero."""
    name = model.joint(joint).name.removeprefix(SIDE)
    if name not in JOINTS:
        return
    low, high = model.jnt_range[joint]
    sign = 1.0 if high >= -low else -1.0
    low, high = sorted((sign * low, sign * high))
    body.add_joint(
        name=JOINTS[name],
        pos=model.jnt_pos[joint],
        axis=sign * model.jnt_axis[joint],
        range=(min(low, IDLE_RANGE_RAD), high),
        limited=True,
        armature=model.dof_armature[model.jnt_dofadr[joint]],
    )


def _add_geoms(body: mujoco.MjsBody, model: mujoco.MjModel, i: int, name: str) -> list[mujoco.MjsGeom]:
    """Add what collides of body ``i``, and return it: primitives as they are, meshes as the boxes around them."""
    geoms = []
    for geom in np.flatnonzero((model.geom_bodyid == i) & (model.geom_contype > 0)):
        shape, size, pos = int(model.geom_type[geom]), model.geom_size[geom], model.geom_pos[geom]
        if shape == mujoco.mjtGeom.mjGEOM_MESH:
            center = np.zeros(3)
            mujoco.mju_rotVecQuat(center, model.geom_aabb[geom, :3], model.geom_quat[geom])
            shape, size, pos = mujoco.mjtGeom.mjGEOM_BOX, model.geom_aabb[geom, 3:], pos + center
        label = f"{HAND_GEOM_PREFIX}{name}_{len(geoms)}"
        geoms += [
            body.add_geom(name=label, type=shape, size=size, pos=pos, quat=model.geom_quat[geom], rgba=SKIN, mass=0)
        ]
    return geoms


def menagerie_model_path() -> Path:
    """Return the path of the hand's model.

    Raises:
        ValueError: if there is none; the message says where it was looked for.
    """
    root = Path(os.environ.get(MENAGERIE_ROOT) or CACHE)
    if not (root / MODEL).is_file():
        raise ValueError(
            f"the hand 'sharpa' is part of MuJoCo Menagerie, but {root} holds no {MODEL}; clone "
            f"github.com/google-deepmind/mujoco_menagerie and let {MENAGERIE_ROOT} name the folder"
        )
    return root / MODEL


def _finger_of(model: mujoco.MjModel, i: int) -> str:
    """Return the finger that body ``i`` belongs to."""
    first = model.body(i).name.removeprefix(SIDE).split("_")[0]
    return {joints[0].split("_")[0]: finger for finger, joints in FLEXIONS.items()}[first]
