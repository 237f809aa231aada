"""The compiled scene: the MuJoCo model and the addresses of hand, target, fixtures and
surroundings.
"""

import functools
from collections import Counter
from collections.abc import Mapping

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import EGO_VIEW, FINGERS, HAND_NAMES
from dynahoi_lerobot.hands import HANDS, Hand
from dynahoi_lerobot.hands.base import HAND_GEOM_PREFIX, PALM_SITE, SKIN_GEOM_PREFIX, SLEEVE_GEOM
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.scene.model import (
    DISTRACTORS,
    FIXTURE_BOXES,
    FURNITURE_SLOTS,
    SCREEN,
    SIDE_CAMERA,
    TARGET_SLOTS,
    WALLS,
    build_model,
    extra_slots,
)


class Scene:
    """The compiled model and its addresses.

    Attributes:
        model: the MuJoCo model; never written to.
        hand: the embodiment in it.
        slots: geom ids of the target's primitives, by shape; ``target_geoms``: of all of them,
            sorted.
        target_body, target_qpos, target_dof: ids and first addresses of the free target.
        hand_qpos: (18,) addresses in qpos, ``hand_dof``: (18,) addresses in qvel, in the order of
            ``HAND_NAMES`` and of the actuators.
        striker_body, striker_geom, striker_dof: the striker's ids and the address of its slide.
        floor_geom: geom id of the floor.
        wall_geoms: geom ids of the walls.
        distractor_geoms: geom ids of the things that are only there to be seen, by shape.
        box_geoms, box_mocap: geom ids and mocap indices of the fixture boxes.
        side_mocap: mocap index of the body that carries the side camera, at the hand's home.
        tether_eq, weld_eq: equality ids; ``tether_geom``: the string drawn on the target body.
        palm_site, tip_sites: the hand's sites.
        camera: id of the ego camera.
        materials: material id of each pattern.
        furniture_geoms: geom ids of the boxes that furniture is made of; ``screen_geom``: of the
            screen.
        skin_geoms, sleeve_geoms: ids of what is drawn of the hand and does not collide.
        hand_geoms: ids of the hand's geoms that collide.
    """

    def __init__(self, model: mujoco.MjModel, hand: Hand) -> None:
        geoms = {model.geom(i).name: i for i in range(model.ngeom)}
        joints = np.array([model.joint(name).id for name in HAND_NAMES])
        target = model.joint("target")
        striker = model.joint("striker")

        def starting(prefix: str) -> np.ndarray:
            return np.array([i for name, i in geoms.items() if name.startswith(prefix)], dtype=int)

        self.model = model
        self.hand = hand
        self.slots = {shape: tuple(starting(f"target_{shape}_").tolist()) for shape in TARGET_SLOTS}
        self.target_geoms = np.sort([geom for ids in self.slots.values() for geom in ids])
        self.target_body = model.body("target").id
        self.target_qpos = int(target.qposadr[0])
        self.target_dof = int(target.dofadr[0])
        self.hand_qpos = model.jnt_qposadr[joints].copy()
        self.hand_dof = model.jnt_dofadr[joints].copy()
        self.striker_body = model.body("striker").id
        self.striker_geom = geoms["striker"]
        self.striker_dof = int(striker.dofadr[0])
        self.floor_geom = geoms["floor"]
        self.wall_geoms = tuple(geoms[name] for name in WALLS)
        self.distractor_geoms = {shape: geoms[f"distractor_{shape}"] for shape in DISTRACTORS}
        self.furniture_geoms = tuple(
            geoms[f"furniture_{number}"] for number in range(FURNITURE_SLOTS)
        )
        self.screen_geom = geoms[SCREEN]
        self.box_geoms = tuple(geoms[name] for name in FIXTURE_BOXES)
        self.box_mocap = tuple(int(model.body(name).mocapid[0]) for name in FIXTURE_BOXES)
        self.side_mocap = int(model.body(SIDE_CAMERA).mocapid[0])
        self.tether_eq = model.equality("tether").id
        self.weld_eq = model.equality("weld").id
        self.tether_geom = geoms["tether"]
        self.palm_site = model.site(PALM_SITE).id
        self.tip_sites = np.array([model.site(f"{finger}_tip").id for finger in FINGERS])
        self.camera = model.camera(EGO_VIEW).id
        self.materials = {model.mat(i).name: i for i in range(model.nmat)}
        self.skin_geoms = starting(SKIN_GEOM_PREFIX)
        self.sleeve_geoms = starting(SLEEVE_GEOM)
        self.hand_geoms = starting(HAND_GEOM_PREFIX)

    def slots_of(self, target: TargetObject) -> list[int]:
        """Return the geom id for each of the target's primitives, in their order.

        Raises:
            ValueError: if the target has more primitives of a shape than there are slots; naming
                it, what it needs and what there is.
        """
        needed = Counter(primitive.shape for primitive in target.primitives)
        if not needed <= Counter({shape: len(ids) for shape, ids in self.slots.items()}):
            raise ValueError(
                f"object {target.name!r} needs {_listed(needed)}, but the compiled scene has "
                f"slots for "
                f"{_listed({shape: len(ids) for shape, ids in self.slots.items()})}; register it "
                f"before the batch is "
                "made, and let no draw of it have more primitives than the one from seed 0"
            )
        free = {shape: iter(ids) for shape, ids in self.slots.items()}
        return [next(free[primitive.shape]) for primitive in target.primitives]


def compile_scene(hand: str = "capsule") -> Scene:
    """Return the scene with the named hand.

    Compiled once for each hand, and once more after an object was registered that needs more slots.
    """
    return _compile(hand, tuple(sorted(extra_slots().items())))


@functools.cache
def _compile(hand: str, extra: tuple[tuple[str, int], ...]) -> Scene:
    embodiment = HANDS[hand]
    return Scene(build_model(embodiment, dict(extra)), embodiment)


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {shape}" for shape, count in sorted(counts.items()))
