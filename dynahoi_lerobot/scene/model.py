"""The MuJoCo model of every episode, compiled once: hand, target, fixtures and surroundings.

The target body carries ``TARGET_SLOTS``, geoms enough for every object of the benchmark, and more
of them if an object registered by somebody else has more primitives of a shape. A world fills the
slots its object uses and hides the rest. So any mix of motions and objects shares a batch, and
nothing is ever recompiled.
"""

import functools
from collections import Counter
from collections.abc import Mapping

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import PHYSICS_DT, ROLLING_FRICTION_M, TORSIONAL_FRICTION_M
from dynahoi_lerobot.hands import Hand
from dynahoi_lerobot.hands.base import (
    HAND_GEOM_PREFIX,
    PALM_BODY,
    SHOWN_GROUP,
    SKIN_GROUP,
    camera_quat,
)
from dynahoi_lerobot.objects import OBJECTS, ObjectType
from dynahoi_lerobot.objects.primitives import GEOM_TYPES
from dynahoi_lerobot.scene.appearance import PATTERNS, texture_pixels
from dynahoi_lerobot.scene.contact_sensors import add_contact_sensors

SHAPES = {shape: mujoco.mjtGeom(code) for shape, code in GEOM_TYPES.items()}
TARGET_SLOTS = {"box": 1, "capsule": 8, "cylinder": 6, "ellipsoid": 1, "sphere": 2}
"""Geoms of each shape that the target body always carries: what the benchmark's objects need,
held-out ones included.

Fixed rather than counted, so that geom ids, and with them contact order and bytes, do not depend on
what is registered.
"""

LARGEST_SLOT_M = 0.12
"""Half-size with which slots are compiled [m]; an object's primitives are no larger."""
ENVIRONMENT, HAND_BIT = 1, 2
"""Collision bits: surfaces and striker answer to the first, the hand to the second; the target asks
for either."""

RIGID_IMPEDANCE = (0.999, 0.999, 0.001, 0.5, 2.0)
"""MuJoCo's ``solimp`` of contacts between the target and anything but the hand."""
SINKING_CORRECTION = 0.001
"""Share of a penetration that becomes, in every physics step, the way out of it in the next: enough
to hold what rests on a surface up, too little to add to a rebound."""
PAD_RATE_RAD_S = 300.0
"""Natural frequency of contacts with the hand's skin, critically damped: nothing rebounds from it,
however the target rebounds elsewhere."""

PAD_IMPEDANCE = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's own, whatever a robot's model says of its skin."""

SURFACE_FRICTION = (1.0, TORSIONAL_FRICTION_M, ROLLING_FRICTION_M)
SMOOTH_FRICTION = (0.0, *SURFACE_FRICTION[1:])
"""Of fixtures, whose own friction is a matter of the motion: of two frictions the greater
counts."""
FIXTURE_BOXES = ("box_a", "box_b")
DISTRACTORS = ("box", "capsule", "cylinder", "sphere")
"""Shapes of the visual-only distractors, one of each."""
FURNITURE_SLOTS = 32
"""Boxes for furniture, visual only; half of them stand before the hand, half behind it."""
SCREEN = "screen"
"""Name of the panel that hides the target under the protocol ``occluded``."""
USES = {"thing": (0.4, 1.0), "floor": (0.22, 8.0), "wall": (0.16, 12.0)}
"""Contrast of a pattern, the share that its dark parts lack, and how often it repeats, by what it
is used for."""
LARGEST_BOX_M = (1.5, 1.0, 0.3)
OFF_FRAME_POS, OFF_FRAME_QUAT = (0.01, 0.01, 0.01), (0.8, 0.6, 0.0, 0.0)
"""A geom compiled at its body's own frame would ignore a position written later."""

HIDDEN_POS = (0.0, 0.0, -5.0)
ARENA_HALF_M = 6.0
WALLS = {
    "wall_front": ((1, 0, 0), (0, 1, 1)),
    "wall_left": ((0, 1, 0), (1, 0, 1)),
    "wall_right": ((0, -1, 0), (1, 0, 1)),
    "wall_back": ((-1, 0, 0), (0, 1, 1)),
}
"""Direction of each wall from the center, and the axes along it. They keep targets in."""
WALL_HALF_THICKNESS_M = 0.1
SHOWN_GROUPS = (SHOWN_GROUP, SKIN_GROUP)
SHININESS = 0.5
"""Of every material; MuJoCo's own for geoms without one, which shine half as much."""

SIDE_CAMERA = "side"
SIDE_CAMERA_POS_M = np.array([1.0, 0.6, 0.5])
SIDE_CAMERA_TARGET_M = np.array([0.35, 0.05, 0.0])
SIDE_CAMERA_FOVY_DEG = 54.0
"""Pose of the static side camera, relative to the palm's center at home: in front of the hand and
to its left, from where the hand seldom hides the target."""


def impact_solref(restitution: float) -> tuple[float, float]:
    """Return MuJoCo's ``solref`` of a rigid contact from which a target rebounds with
    ``restitution``.

    The two are stiffness k and damping b per mass, negative by MuJoCo's convention: a contact with
    penetration r and approach speed v accelerates by k r + b v. With b = (1 + e) / h the first step
    turns v into -e v (Newton's law of restitution), wherever in that step the contact begins; a
    spring would return more or less depending on it.
    """
    return (-SINKING_CORRECTION / PHYSICS_DT**2, -(1 + restitution) / PHYSICS_DT)


def build_model(hand: Hand, extra_slots: Mapping[str, int]) -> mujoco.MjModel:
    """Compile the model with a hand and so many slots of each shape beyond ``TARGET_SLOTS``."""
    spec = mujoco.MjSpec()
    _set_options(spec)
    _add_materials(spec)
    _add_surroundings(spec)
    _add_solids(spec)
    hand.add_to(spec)
    _set_hand_collisions(spec)
    _add_target(spec, extra_slots)
    _add_fixtures(spec)
    add_contact_sensors(spec)
    return spec.compile()


def _set_options(spec: mujoco.MjSpec) -> None:
    spec.compiler.degree = False
    spec.option.timestep = PHYSICS_DT
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.visual.map.znear, spec.visual.map.zfar = 0.005, 40.0
    spec.stat.extent, spec.stat.center = 1.0, (0.0, 0.0, 1.0)
    spec.visual.headlight.ambient = (0.35, 0.35, 0.35)
    spec.visual.headlight.diffuse = (0.2, 0.2, 0.2)
    spec.visual.headlight.specular = (0.0, 0.0, 0.0)
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(0, 0, 4),
        dir=(0.5, 0.2, -1),
        castshadow=True,
        diffuse=(0.6, 0.6, 0.6),
        specular=(0.0, 0.0, 0.0),
    )


def _add_materials(spec: mujoco.MjSpec) -> None:
    for pattern in PATTERNS:
        for use, (contrast, repeat) in USES.items():
            pixels = texture_pixels(pattern, contrast)
            texture = spec.add_texture(
                name=f"{pattern}_{use}",
                type=mujoco.mjtTexture.mjTEXTURE_2D,
                width=pixels.shape[1],
                height=pixels.shape[0],
                nchannel=3,
            )
            texture.data = pixels.tobytes()
            material = spec.add_material(
                name=f"{pattern}_{use}",
                texrepeat=(repeat, repeat),
                specular=1.0,
                shininess=SHININESS,
            )
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"{pattern}_{use}"


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    half = ARENA_HALF_M
    spec.worldbody.add_geom(
        name="floor",
        type=plane,
        size=(half, half, 0.1),
        contype=0,
        conaffinity=ENVIRONMENT,
        material="plain_floor",
        condim=6,
        friction=SURFACE_FRICTION,
    )
    for name, (side, aside) in WALLS.items():
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=np.multiply(side, half + WALL_HALF_THICKNESS_M),
            size=np.add(
                np.multiply(np.abs(side), WALL_HALF_THICKNESS_M), np.multiply(aside, 2 * half)
            ),
            contype=0,
            conaffinity=ENVIRONMENT,
            material="plain_wall",
        )


def _set_hand_collisions(spec: mujoco.MjSpec) -> None:
    """Let the hand collide with targets that ask for it, and with nothing else."""
    for geom in spec.geoms:
        if geom.name.startswith(HAND_GEOM_PREFIX):
            geom.contype = 0
            geom.conaffinity = HAND_BIT
            geom.condim = 6
            geom.priority = 2
            geom.friction = SURFACE_FRICTION
            geom.solref = (1 / PAD_RATE_RAD_S, 1.0)
            geom.solimp = PAD_IMPEDANCE


def _add_target(spec: mujoco.MjSpec, extra: Mapping[str, int]) -> None:
    body = spec.worldbody.add_body(name="target", pos=(0, 0, 1.5))
    body.explicitinertial = True
    body.mass = 0.1
    body.inertia = (4e-5, 5e-5, 6e-5)
    body.ipos = (0.0, 0.0, 0.0)
    body.add_freejoint(name="target")
    for shape, count in TARGET_SLOTS.items():
        _add_slots(body, shape, range(count))
    body.add_geom(
        name="tether",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=(0.003, 0.5, 0),
        mass=0.0,
        contype=0,
        conaffinity=0,
        rgba=(0.25, 0.25, 0.25, 1),
        pos=OFF_FRAME_POS,
        quat=OFF_FRAME_QUAT,
    )
    for shape, count in extra.items():
        _add_slots(body, shape, range(TARGET_SLOTS[shape], TARGET_SLOTS[shape] + count))


def _add_slots(body: mujoco.MjsBody, shape: str, numbers: range) -> None:
    for number in numbers:
        body.add_geom(
            name=f"target_{shape}_{number}",
            type=SHAPES[shape],
            size=(LARGEST_SLOT_M,) * 3,
            mass=0.0,
            contype=ENVIRONMENT | HAND_BIT,
            conaffinity=0,
            condim=6,
            friction=SURFACE_FRICTION,
            priority=1,
            material="plain_thing",
            solimp=RIGID_IMPEDANCE,
            pos=OFF_FRAME_POS,
            quat=OFF_FRAME_QUAT,
        )


def _add_solids(spec: mujoco.MjSpec) -> None:
    """Add visual-only geoms: furniture, distractors and the screen."""
    names = {f"furniture_{number}": "box" for number in range(FURNITURE_SLOTS)}
    names |= {f"distractor_{shape}": shape for shape in DISTRACTORS} | {SCREEN: "box"}
    for name, shape in names.items():
        spec.worldbody.add_geom(
            name=name, type=SHAPES[shape], size=(LARGEST_SLOT_M,) * 3, contype=0, conaffinity=0,
            material="plain_thing", pos=OFF_FRAME_POS, quat=OFF_FRAME_QUAT,
        )  # fmt: skip


def _add_fixtures(spec: mujoco.MjSpec) -> None:
    for name in FIXTURE_BOXES:
        body = spec.worldbody.add_body(name=name, mocap=True, pos=HIDDEN_POS)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=LARGEST_BOX_M,
            contype=0,
            conaffinity=ENVIRONMENT,
            material="plain_thing",
            condim=6,
            friction=SMOOTH_FRICTION,
            priority=1,
            solimp=RIGID_IMPEDANCE,
        )
    home = spec.worldbody.add_body(name=SIDE_CAMERA, mocap=True)
    quat = camera_quat(SIDE_CAMERA_TARGET_M - SIDE_CAMERA_POS_M)
    home.add_camera(name=SIDE_CAMERA, pos=SIDE_CAMERA_POS_M, quat=quat, fovy=SIDE_CAMERA_FOVY_DEG)
    striker = spec.worldbody.add_body(name="striker", pos=HIDDEN_POS, gravcomp=1.0)
    striker.explicitinertial = True
    striker.mass = 0.3
    striker.inertia = (2e-4,) * 3
    striker.ipos = (0.0, 0.0, 0.0)
    striker.add_joint(name="striker", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(1, 0, 0))
    striker.add_geom(
        name="striker",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(0.04, 0, 0),
        contype=0,
        conaffinity=ENVIRONMENT,
        mass=0.0,
        rgba=(0.2, 0.2, 0.22, 1),
        condim=3,
        friction=SMOOTH_FRICTION,
        priority=1,
        solimp=RIGID_IMPEDANCE,
    )
    stiff = {"solref": (0.004, 1.0), "solimp": (0.99, 0.999, 0.001, 0.5, 2.0)}
    tether = spec.add_equality(
        name="tether",
        type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1="target",
        active=False,
        **stiff,
    )
    tether.data[:3] = (0.0, 0.0, 0.5)
    spec.add_equality(
        name="weld",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1="target",
        name2=PALM_BODY,
        active=False,
        **stiff,
    )


def extra_slots() -> Counter[str]:
    """Return how many slots of each shape the registered objects need beyond ``TARGET_SLOTS``.

    An object is drawn once to count its primitives, from seed 0.
    """
    most: Counter[str] = Counter()
    for _, object_type in OBJECTS.items():
        most |= _primitive_counts(object_type)
    return most - Counter(TARGET_SLOTS)


@functools.cache
def _primitive_counts(object_type: ObjectType) -> Counter[str]:
    return Counter(
        primitive.shape for primitive in object_type.sample(np.random.default_rng(0)).primitives
    )
