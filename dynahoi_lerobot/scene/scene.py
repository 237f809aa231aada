"""The compiled scene: the MuJoCo model and the addresses of hand, target, fixtures and surroundings."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGERS
from dynahoi_lerobot.hands import HANDS, Hand
from dynahoi_lerobot.hands.base import EGO_CAMERA, HAND_GEOM_PREFIX, PALM_BODY, PALM_SITE, SKIN_GEOM_PREFIX, SLEEVE_GEOM
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.scene.model import (
    DISTRACTORS,
    FIXTURE_BOXES,
    FURNITURE_SLOTS,
    SCREEN,
    SHOWN_WALLS,
    SIDE_CAMERA,
    TARGET_SLOTS,
    build_model,
    extra_slots,
)


@dataclass(frozen=True)
class Scene:
    """The compiled model and its addresses.

    Attributes:
        model: the MuJoCo model; never written to.
        hand: the embodiment in it.
        slots: geom ids of the target's primitives, by shape.
        target_body, target_qpos, target_dof: ids and first addresses of the free target.
        hand_qpos: (18,) addresses in qpos, ``hand_dof``: (18,) addresses in qvel, in the order of the actuators.
        striker_body, striker_qpos, striker_dof: the striker's body and the addresses of its slide.
        wall_geoms: geom ids of the walls that are drawn.
        distractor_geoms: geom ids of the things that are only there to be seen, by shape.
        box_geoms, box_mocap: geom ids and mocap indices of the fixture boxes.
        side_mocap: mocap index of the body that carries the side camera, at the hand's home.
        tether_eq, weld_eq: equality ids; ``tether_geom``: the string drawn on the target body.
        palm_site, tip_sites, palm_body: the hand's sites and body.
        camera: id of the ego camera.
        materials: material id of each pattern.
        furniture_geoms: geom ids of the boxes that furniture is made of; ``screen_geom``: of the screen.
        skin_geoms, sleeve_geoms: ids of what is drawn of the hand and does not collide.
        hand_geoms: ids of the hand's geoms that collide; ``finger_geoms``: (5, K) the geoms of each finger.
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
    wall_geoms: tuple[int, ...]
    distractor_geoms: dict[str, int]
    furniture_geoms: tuple[int, ...]
    screen_geom: int
    skin_geoms: np.ndarray
    sleeve_geoms: np.ndarray
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


@functools.cache
def _compile(hand: str, extra: tuple[tuple[str, int], ...]) -> Scene:
    embodiment = HANDS[hand]()
    return _index(build_model(embodiment, dict(extra)), embodiment)


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
        wall_geoms=tuple(geoms[name] for name in SHOWN_WALLS),
        distractor_geoms={shape: geoms[f"distractor_{shape}"] for shape in DISTRACTORS},
        furniture_geoms=tuple(geoms[f"furniture_{number}"] for number in range(FURNITURE_SLOTS)),
        screen_geom=geoms[SCREEN],
        skin_geoms=_starting(geoms, SKIN_GEOM_PREFIX),
        sleeve_geoms=_starting(geoms, SLEEVE_GEOM),
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
        hand_geoms=_starting(geoms, HAND_GEOM_PREFIX),
        finger_geoms=np.array(fingers),
    )


def _starting(geoms: Mapping[str, int], prefix: str) -> np.ndarray:
    return np.array([i for name, i in geoms.items() if name.startswith(prefix)], dtype=int)


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {shape}" for shape, count in sorted(counts.items()))
