"""The one compiled model: hand, target, fixtures, surroundings. Every episode is a row of numbers over it.

The target body carries ``TARGET_SLOTS``, geoms enough for every object of the benchmark, and more of them if an object
registered by somebody else has more primitives of a shape. A world fills the slots its object uses and hides the rest.
So any mix of motions and objects shares a batch, and nothing is ever recompiled.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from dynahoi_lerobot.appearance import PATTERNS, texture_pixels
from dynahoi_lerobot.foundation.conventions import FINGERS, PHYSICS_DT
from dynahoi_lerobot.hands import HANDS, Hand
from dynahoi_lerobot.hands.base import EGO_CAMERA, HAND_GEOM_PREFIX, PALM_BODY, PALM_SITE, camera_quat
from dynahoi_lerobot.objects import OBJECTS, ObjectType, TargetObject
from dynahoi_lerobot.objects.base import ROLLING_FRICTION_M, TORSIONAL_FRICTION_M
from dynahoi_lerobot.scene.contact_sensors import add_contact_sensors

SHAPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
TARGET_SLOTS = {"box": 1, "capsule": 8, "cylinder": 6, "ellipsoid": 1, "sphere": 2}
"""Geoms of each shape that the target body always carries: what the benchmark's objects need, held-out ones included.

Fixed rather than counted, so that geom ids, and with them contact order and bytes, do not depend on what is registered.
"""
ENVIRONMENT, HAND_BIT = 1, 2
"""Collision bits: surfaces and striker answer to the first, the hand to the second; the target asks for either."""

CONTACT_RATE_RAD_S = 300.0
"""Natural frequency of contacts: the stiffest spring that 500 Hz resolves well (five steps a bounce)."""
PAD_SOLMIX = 1e4
"""The hand's skin decides how it meets the target: critically damped, so that nothing rebounds from it, however the
target rebounds elsewhere."""

SURFACE_FRICTION = (1.0, TORSIONAL_FRICTION_M, ROLLING_FRICTION_M)
FIXTURE_BOXES = ("box_a", "box_b")
DISTRACTORS = ("box", "capsule", "cylinder", "sphere")
"""Shapes of the things that are only there to be seen, one of each."""
LARGEST_SLOT_M = 0.12
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
"""Direction of each wall from the centre, and the axes along it. They keep targets in; only the first is drawn."""
BACKDROP = "wall_front"
WALL_HALF_THICKNESS_M = 0.1
SHOWN_GROUP, HIDDEN_GROUP = 0, 4
SHININESS = 0.5
"""Of every material; MuJoCo's own for geoms without one, which shine half as much."""

SIDE_CAMERA = "side"
SIDE_CAMERA_POS_M, SIDE_CAMERA_TARGET_M = np.array([-0.65, -0.6, 0.4]), np.array([0.35, 0.05, 0.0])
SIDE_CAMERA_FOVY_DEG = 54.0
"""A camera that stands still, behind the waiting hand and to its right; from the palm centre at home."""


@dataclass(frozen=True)
class Scene:
    """The compiled model and where things are in it.

    Attributes:
        model: the MuJoCo model; never written to.
        hand: the embodiment in it.
        slots: geom ids of the target's primitives, by shape.
        target_body, target_qpos, target_dof: ids and first addresses of the free target.
        hand_qpos: (18,) addresses in qpos, ``hand_dof``: (18,) addresses in qvel, in the order of the actuators.
        striker_body, striker_qpos, striker_dof: the striker's body and the addresses of its slide.
        distractor_geoms: geom ids of the things that are only there to be seen, by shape.
        box_geoms, box_mocap: geom ids and mocap indices of the fixture boxes.
        side_mocap: mocap index of the body that carries the side camera, at the hand's home.
        tether_eq, weld_eq: equality ids; ``tether_geom``: the string drawn on the target body.
        palm_site, tip_sites, palm_body: the hand's sites and body.
        camera: id of the ego camera.
        materials: material id of each pattern.
        hand_geoms: ids of the hand's geoms; ``finger_geoms``: (5, K) the geoms of each finger.
    """

    model: mujoco.MjModel
    hand: Hand
    slots: dict[str, tuple[int, ...]]
    target_body: int
    target_qpos: int
    target_dof: int
    hand_qpos: np.ndarray
    hand_dof: np.ndarray
    striker_body: int
    striker_geom: int
    striker_qpos: int
    striker_dof: int
    floor_geom: int
    backdrop_geom: int
    distractor_geoms: dict[str, int]
    box_geoms: tuple[int, ...]
    box_mocap: tuple[int, ...]
    side_mocap: int
    tether_eq: int
    tether_geom: int
    weld_eq: int
    palm_site: int
    palm_body: int
    tip_sites: np.ndarray
    camera: int
    materials: dict[str, int]
    hand_geoms: np.ndarray
    finger_geoms: np.ndarray

    @property
    def target_geoms(self) -> np.ndarray:
        """Geom ids of all slots of the target."""
        return np.array(sorted(g for ids in self.slots.values() for g in ids))

    def slots_of(self, target: TargetObject) -> list[int]:
        """Return the geom id for each of the target's primitives, in their order.

        Raises:
            ValueError: if the target has more primitives of a shape than there are slots; naming it, what it needs and
                what there is.
        """
        needed = Counter(primitive.shape for primitive in target.primitives)
        if not needed <= Counter({shape: len(ids) for shape, ids in self.slots.items()}):
            raise ValueError(
                f"object {target.name!r} needs {_listed(needed)}, but the compiled scene has slots for "
                f"{_listed({shape: len(ids) for shape, ids in self.slots.items()})}; register it before the batch is "
                "made, and let no draw of it have more primitives than the one from seed 0"
            )
        free = {shape: iter(ids) for shape, ids in self.slots.items()}
        return [next(free[primitive.shape]) for primitive in target.primitives]


def compile_scene(hand: str = "capsule") -> Scene:
    """Return the scene with the named hand.

    Compiled once for each hand, and once more after an object was registered that needs more slots.
    """
    return _compile(hand, tuple(sorted(extra_slots().items())))


def extra_slots() -> Counter[str]:
    """Return how many slots of each shape the registered objects need beyond ``TARGET_SLOTS``.

    An object is drawn once to count its primitives, from seed 0.
    """
    most: Counter[str] = Counter()
    for name, object_type in OBJECTS.items():
        most |= _primitive_counts(name, object_type)
    return most - Counter(TARGET_SLOTS)


@functools.cache
def _primitive_counts(name: str, object_type: type[ObjectType]) -> Counter[str]:
    return Counter(primitive.shape for primitive in object_type.sample(name, np.random.default_rng(0)).primitives)


@functools.cache
def _compile(hand: str, extra: tuple[tuple[str, int], ...]) -> Scene:
    embodiment = HANDS[hand]()
    spec = mujoco.MjSpec()
    _set_options(spec)
    _add_materials(spec)
    _add_surroundings(spec)
    _add_distractors(spec)
    embodiment.add_to(spec)
    _set_hand_collisions(spec)
    _add_target(spec, dict(extra))
    _add_fixtures(spec)
    add_contact_sensors(spec)
    return _index(spec.compile(), embodiment)


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
        name="sun", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=(0, 0, 4), dir=(0.5, 0.2, -1), castshadow=True,
        diffuse=(0.6, 0.6, 0.6), specular=(0.0, 0.0, 0.0),
    )  # fmt: skip


def _add_materials(spec: mujoco.MjSpec) -> None:
    for pattern in PATTERNS:
        pixels = texture_pixels(pattern)
        texture = spec.add_texture(
            name=pattern,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=pixels.shape[1],
            height=pixels.shape[0],
            nchannel=3,
        )
        texture.data = pixels.tobytes()
        for scale, repeat in (("fine", 1.0), ("coarse", 5.0)):
            material = spec.add_material(
                name=f"{pattern}_{scale}", texrepeat=(repeat, repeat), specular=1.0, shininess=SHININESS
            )
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = pattern


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    half = ARENA_HALF_M
    spec.worldbody.add_geom(
        name="floor", type=plane, size=(half, half, 0.1), contype=0, conaffinity=ENVIRONMENT, material="plain_coarse",
        condim=6, friction=SURFACE_FRICTION,
    )  # fmt: skip
    for name, (side, aside) in WALLS.items():
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=np.multiply(side, half + WALL_HALF_THICKNESS_M),
            size=np.add(np.multiply(np.abs(side), WALL_HALF_THICKNESS_M), np.multiply(aside, 2 * half)),
            contype=0, conaffinity=ENVIRONMENT, material="plain_coarse",
            group=SHOWN_GROUP if name == BACKDROP else HIDDEN_GROUP,
        )  # fmt: skip


def _set_hand_collisions(spec: mujoco.MjSpec) -> None:
    """Let the hand answer to targets that ask for it, and to nothing else."""
    for geom in spec.geoms:
        if geom.name.startswith(HAND_GEOM_PREFIX):
            geom.contype, geom.conaffinity, geom.condim = 0, HAND_BIT, 6
            geom.priority, geom.solmix, geom.solref = 1, PAD_SOLMIX, (1 / CONTACT_RATE_RAD_S, 1.0)


def _add_target(spec: mujoco.MjSpec, extra: dict[str, int]) -> None:
    body = spec.worldbody.add_body(name="target", pos=(0, 0, 1.5))
    body.explicitinertial, body.mass, body.inertia, body.ipos = True, 0.1, (4e-5, 5e-5, 6e-5), (0.0, 0.0, 0.0)
    body.add_freejoint(name="target")
    for shape, count in TARGET_SLOTS.items():
        _add_slots(body, shape, range(count))
    body.add_geom(
        name="tether", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.003, 0.5, 0), mass=0.0, contype=0, conaffinity=0,
        rgba=(0.25, 0.25, 0.25, 1), pos=OFF_FRAME_POS, quat=OFF_FRAME_QUAT,
    )  # fmt: skip
    for shape, count in extra.items():
        _add_slots(body, shape, range(TARGET_SLOTS[shape], TARGET_SLOTS[shape] + count))


def _add_slots(body: mujoco.MjsBody, shape: str, numbers: range) -> None:
    for number in numbers:
        body.add_geom(
            name=f"target_{shape}_{number}", type=SHAPES[shape], size=(LARGEST_SLOT_M,) * 3, mass=0.0,
            contype=ENVIRONMENT | HAND_BIT, conaffinity=0, condim=6, friction=SURFACE_FRICTION, priority=1,
            material="plain_fine", pos=OFF_FRAME_POS, quat=OFF_FRAME_QUAT,
        )  # fmt: skip


def _add_distractors(spec: mujoco.MjSpec) -> None:
    for shape in DISTRACTORS:
        spec.worldbody.add_geom(
            name=f"distractor_{shape}", type=SHAPES[shape], size=(LARGEST_SLOT_M,) * 3, contype=0, conaffinity=0,
            material="plain_fine", pos=OFF_FRAME_POS, quat=OFF_FRAME_QUAT,
        )  # fmt: skip


def _add_fixtures(spec: mujoco.MjSpec) -> None:
    for name in FIXTURE_BOXES:
        body = spec.worldbody.add_body(name=name, mocap=True, pos=HIDDEN_POS)
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=LARGEST_BOX_M, contype=0, conaffinity=ENVIRONMENT,
            material="plain_fine", condim=6, friction=SURFACE_FRICTION,
        )  # fmt: skip
    home = spec.worldbody.add_body(name=SIDE_CAMERA, mocap=True)
    quat = camera_quat(SIDE_CAMERA_TARGET_M - SIDE_CAMERA_POS_M)
    home.add_camera(name=SIDE_CAMERA, pos=SIDE_CAMERA_POS_M, quat=quat, fovy=SIDE_CAMERA_FOVY_DEG)
    striker = spec.worldbody.add_body(name="striker", pos=HIDDEN_POS, gravcomp=1.0)
    striker.explicitinertial, striker.mass, striker.inertia, striker.ipos = True, 0.3, (2e-4,) * 3, (0.0, 0.0, 0.0)
    striker.add_joint(name="striker", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(1, 0, 0))
    striker.add_geom(
        name="striker", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.04, 0, 0), contype=0, conaffinity=ENVIRONMENT,
        mass=0.0, rgba=(0.2, 0.2, 0.22, 1), condim=3,
    )  # fmt: skip
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
        name="weld", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="target", name2=PALM_BODY,
        active=False, **stiff,
    )  # fmt: skip


def _index(model: mujoco.MjModel, hand: Hand) -> Scene:
    geoms = {model.geom(i).name: i for i in range(model.ngeom)}
    slots = {
        shape: tuple(i for name, i in geoms.items() if name.startswith(f"target_{shape}_")) for shape in TARGET_SLOTS
    }
    joints = model.actuator_trnid[:, 0]
    target, striker = model.joint("target"), model.joint("striker")
    fingers = [
        [g for name, g in geoms.items() if name.startswith(f"{HAND_GEOM_PREFIX}{finger}_")] for finger in FINGERS
    ]
    return Scene(
        model=model,
        hand=hand,
        slots=slots,
        target_body=model.body("target").id,
        target_qpos=int(target.qposadr[0]),
        target_dof=int(target.dofadr[0]),
        hand_qpos=model.jnt_qposadr[joints].copy(),
        hand_dof=model.jnt_dofadr[joints].copy(),
        striker_body=model.body("striker").id,
        striker_geom=geoms["striker"],
        striker_qpos=int(striker.qposadr[0]),
        striker_dof=int(striker.dofadr[0]),
        floor_geom=geoms["floor"],
        backdrop_geom=geoms[BACKDROP],
        distractor_geoms={shape: geoms[f"distractor_{shape}"] for shape in DISTRACTORS},
        box_geoms=tuple(geoms[n] for n in FIXTURE_BOXES),
        box_mocap=tuple(int(model.body(n).mocapid[0]) for n in FIXTURE_BOXES),
        side_mocap=int(model.body(SIDE_CAMERA).mocapid[0]),
        tether_eq=model.equality("tether").id,
        tether_geom=geoms["tether"],
        weld_eq=model.equality("weld").id,
        palm_site=model.site(PALM_SITE).id,
        palm_body=model.body(PALM_BODY).id,
        tip_sites=np.array([model.site(f"{finger}_tip").id for finger in FINGERS]),
        camera=model.camera(EGO_CAMERA).id,
        materials={model.mat(i).name: i for i in range(model.nmat)},
        hand_geoms=np.array([i for name, i in geoms.items() if name.startswith(HAND_GEOM_PREFIX)], dtype=int),
        finger_geoms=np.array(fingers),
    )


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {shape}" for shape, count in sorted(counts.items()))
