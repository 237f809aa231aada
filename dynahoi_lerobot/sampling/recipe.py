"""A recipe: everything besides the seed that decides what an episode is. One YAML file, read by draccus."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import draccus

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.foundation.yaml_file import read_yaml
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.renderers import DEFAULT_RENDERER
from dynahoi_lerobot.renderers.views import check_views
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.randomization import check_appearance

SPLITS = ("train", "val", "test", "ood_speed", "ood_object", "ood_motion")
"""Disjoint seed streams; ``test_small`` is the first 110 episodes of ``test``."""
PROTOCOLS = ("observe_before_act", "direct_act")
INSTRUCTIONS = ("reveal", "neutral", "mixed")
SHORTEST_HOLD_FRAMES = 12
"""The last retry aims nine frames later than the first attempt, and must still be seen to succeed."""
MAX_DISTURBANCE_M = 0.2
OOD_TEMPO = 1.6
"""In ``ood_speed``, speeds begin where training's end and reach this many times as far."""


@dataclass(frozen=True)
class Recipe:
    """What to generate or to play.

    Attributes:
        split: seed stream, one of ``SPLITS``.
        motions: kinds to cycle through; empty means all that the split allows.
        objects: objects to draw from; empty means all that the split allows.
        protocol: ``observe_before_act`` or ``direct_act``.
        capture: capture rule.
        hand: embodiment; the capture rule's own if empty.
        expert: who demonstrates; likewise.
        instructions: whether texts name the motion: ``reveal``, ``neutral`` or ``mixed``.
        appearance: what of it is randomised more strongly: see `appearance.py`.
        image_size: side of the square camera images [px].
        views: pictures besides those of the hand's camera, of the same size: see `views.py`.
        renderer: one of the renderers.
        hold_frames: frames to record after the intercept, None for all of the L that the episode was drawn with. On
            average two thirds of those only hold what is already caught; a training set needs few of them.
        disturbance_m: spread of the pushes that make the palm miss its commands on the way [m]; see `disturbance.py`.
    """

    split: str = "train"
    motions: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    protocol: str = "observe_before_act"
    capture: str = "attach"
    hand: str = ""
    expert: str = ""
    instructions: str = "mixed"
    appearance: tuple[str, ...] = ()
    image_size: int = 128
    views: tuple[str, ...] = ()
    renderer: str = DEFAULT_RENDERER
    hold_frames: int | None = None
    disturbance_m: float = 0.0

    def __post_init__(self) -> None:
        """Check every name against what exists.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        for value, allowed, noun in (
            (self.split, SPLITS, "split"),
            (self.protocol, PROTOCOLS, "protocol"),
            (self.instructions, INSTRUCTIONS, "instructions"),
        ):
            if value not in allowed:
                raise ValueError(f"unknown {noun} {value!r}; known: {', '.join(allowed)}")
        rule = CAPTURES[self.capture]
        object.__setattr__(self, "hand", self.hand or rule.hand)
        object.__setattr__(self, "expert", self.expert or rule.expert)
        for name in self.motions:
            self._check_held_out("motion", name, MOTIONS[name].held_out)
        for name in self.objects:
            self._check_held_out("object", name, OBJECTS[name].held_out)
        check_appearance(self.appearance)
        check_views(self.views)
        if not 16 <= self.image_size <= 1024:
            raise ValueError(f"image_size must be 16 to 1024 pixels, got {self.image_size}")
        if not 0 <= self.disturbance_m <= MAX_DISTURBANCE_M:
            raise ValueError(f"disturbance_m must be 0 to {MAX_DISTURBANCE_M} m, got {self.disturbance_m}")
        if self.hold_frames is not None and self.hold_frames < SHORTEST_HOLD_FRAMES:
            raise ValueError(f"hold_frames must be at least {SHORTEST_HOLD_FRAMES}, or null, got {self.hold_frames}")

    @property
    def motion_names(self) -> list[str]:
        """The kinds the recipe cycles through: those it lists, or, sorted, all that some object of it can perform."""
        if self.motions:
            return list(self.motions)
        held_out, objects = self.split == "ood_motion", set(self.object_names)
        return [name for name, kind in MOTIONS.items() if kind.held_out == held_out and objects & set(kind.objects())]

    @property
    def object_names(self) -> list[str]:
        """The objects the recipe draws from."""
        if self.objects:
            return list(self.objects)
        held_out = self.split == "ood_object"
        return [name for name, kind in OBJECTS.items() if kind.held_out == held_out]

    @property
    def tempo(self) -> float:
        """How far speeds reach beyond training's; 1 where they do not."""
        return OOD_TEMPO if self.split == "ood_speed" else 1.0

    def _check_held_out(self, noun: str, name: str, held_out: bool) -> None:
        """Refuse what belongs to ``ood_motion`` or ``ood_object`` anywhere else, and everything else there."""
        split = f"ood_{noun}"
        if held_out and self.split != split:
            raise ValueError(f"{noun} {name!r} is held out for split {split!r}, got split {self.split!r}")
        if not held_out and self.split == split:
            raise ValueError(f"split {split!r} holds only held-out {noun}s, got {noun} {name!r}")

    def fingerprint(self) -> str:
        """Return 16 hex digits that identify this recipe together with the code that plays it."""
        text = json.dumps(dataclasses.asdict(self), sort_keys=True) + code_fingerprint()
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_recipe(path: Path) -> Recipe:
    """Read a recipe from YAML.

    Raises:
        ValueError: if the file does not exist, is refused by ``read_yaml`` or holds an unknown key or value.
    """
    if not path.is_file():
        raise ValueError(f"there is no recipe at {path}")
    values = read_yaml(path)
    if values is None:  # nothing but comments
        return Recipe()
    if not isinstance(values, dict):
        raise ValueError(f"{path} must map keys to values, got a {type(values).__name__}")
    try:
        return draccus.decode(Recipe, values)
    except draccus.utils.DraccusException as error:
        told = error if isinstance(error, draccus.utils.DecodingError) else error.__cause__ or error
        raise ValueError(f"{path}: {told}") from error
