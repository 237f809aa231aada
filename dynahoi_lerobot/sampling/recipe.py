"""Recipe: everything besides the seed that decides what an episode is; as a YAML file, read by
draccus.
"""

import dataclasses
import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.control_mode import CONTROL_MODES, JOINTS
from dynahoi_lerobot.core.conventions import DEFAULT_IMAGE_SIZE_PX, DETECTOR_IMAGE_SIZE_PX
from dynahoi_lerobot.core.features import ENVIRONMENT_STATES, EYE, Feature, frame_features
from dynahoi_lerobot.core.reading import decoded, read_yaml, reading
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.core.rules import (
    CONTROL_CLASSES,
    DEFAULT_CONTROL_CLASS,
    DEFAULT_PROTOCOL,
    PROTOCOLS,
)
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.experts.base import Teacher
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.renderers import DEFAULT_RENDERER, RENDERERS
from dynahoi_lerobot.renderers.views import OPTIONAL_VIEWS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK, Split
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint, extension_fingerprint
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS
from dynahoi_lerobot.sampling.salt import check_salt, seal

INSTRUCTION_STYLES: tuple[str, ...] = ("reveal", "neutral", "mixed")
"""``reveal`` names object and motion, ``neutral`` the object only, ``mixed`` is either with equal
probability."""
MAX_RENDER_NOISE = 64
IMAGE_SIZES_PX = (16, 1024)
RECORDING = ("expert", "perturbed_share", "keep_failures", "actor")
"""Fields that matter only where a dataset is recorded."""
ACTOR = re.compile(r"[a-z0-9_]+@[0-9a-f]{16}")


@dataclass(frozen=True)
class Recipe:
    """The rules by which episodes are generated or played.

    The text of a field is also the help of the command-line option named after it.
    """

    split: str = option(
        "train",
        "train, val, test, test_small, twins or one of the ood_ splits; selects the seed stream",
    )
    motions: tuple[str, ...] = option(
        (),
        "comma-separated kinds of motion to cycle through; by default those of the split. "
        "Registered motions outside "
        "the benchmark must be named here",
    )
    objects: tuple[str, ...] = option(
        (), "comma-separated objects to sample from; by default those of the split"
    )
    path_speed: float = option(
        1.0, "speed factor along the target's path: 1, or in split twins also 1.6"
    )
    protocol: str = option(
        DEFAULT_PROTOCOL,
        "observation protocol: observe_before_act, direct_act, observe_then_blind or occluded",
    )
    control_class: str = option(
        DEFAULT_CONTROL_CLASS,
        "speed limits and command latency of the hand: standard, late or unlimited",
    )
    control_mode: str = option(
        JOINTS,
        "action space: joints (palm position and 15 joint angles) or grasp (palm displacement "
        "and closure of the hand)",
    )
    capture: str = option("attach", "capture rule: attach, attach_lenient or contact")
    hand: str = option("", "hand model; by default that of the capture rule")
    expert: str = option("", "demonstrating expert; by default that of the capture rule")
    instructions: str = option(
        "mixed", "whether language instructions name the motion: reveal, neutral or mixed"
    )
    appearance: tuple[str, ...] = option(
        (),
        "comma-separated visual randomisations beyond the training distribution: materials, "
        "lights, specular, "
        "transparency, distractors",
    )
    image_size: int = option(
        DEFAULT_IMAGE_SIZE_PX, "side of the square images [px]; 0 renders none"
    )
    views: tuple[str, ...] = option(
        (), "comma-separated views in addition to ego, the hand's camera, such as side or ego_depth"
    )
    renderer: str = option(DEFAULT_RENDERER, "image renderer")
    perturbed_share: float = option(
        0.5,
        "share of episodes in which the palm is pushed off course at times, if the expert can "
        "recover",
    )
    render_noise: int = option(
        0, "largest random change of each image value, in levels of 255; imitates another renderer"
    )
    salt: str = option(
        "",
        "secret text that selects hidden episodes of the same benchmark; only its hash is stored",
        repr=False,
    )
    environment_state: str = option(
        "",
        "add observation.environment_state to the observations: truth, the target's pose and "
        "velocity; or eye, where "
        "a pretrained image encoder sees the target",
    )
    keep_failures: bool = option(
        False, "also store episodes in which the expert fails, instead of replacing them"
    )
    actor: str = option(
        "",
        "policy that moves the hand while the expert labels its states, TYPE@HASH of its "
        "checkpoint; empty if the "
        "expert demonstrates. Its failures are always kept",
    )

    def __post_init__(self) -> None:
        """Check every name against what exists.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        for value, allowed, noun in (
            (self.split, BENCHMARK.splits, "split"),
            (self.protocol, PROTOCOLS, "protocol"),
            (self.control_class, CONTROL_CLASSES, "control class"),
            (self.control_mode, CONTROL_MODES, "control mode"),
            (self.instructions, dict.fromkeys(INSTRUCTION_STYLES), "instructions"),
            (self.environment_state, ENVIRONMENT_STATES, "environment_state"),
            *((name, RANDOMIZATIONS, "appearance") for name in self.appearance),
            *((name, dict.fromkeys(OPTIONAL_VIEWS), "extra view") for name in self.views),
        ):
            known(noun, value, allowed)
        rule = CAPTURES[self.capture]
        object.__setattr__(self, "hand", self.hand or rule.hand)
        object.__setattr__(self, "expert", self.expert or rule.expert)
        HANDS.check(self.hand)
        EXPERTS.check(self.expert)
        RENDERERS.check(self.renderer)
        for noun, registry, chosen in (
            ("motion", MOTIONS, self.motions),
            ("object", OBJECTS, self.objects),
        ):
            for name in chosen:
                registry[name]  # raises if there is none
                self._check_split_of(noun, name)
        speeds = self.split_definition.path_speeds
        if self.path_speed not in speeds:
            allowed = ", ".join(f"{speed:g}" for speed in speeds)
            raise ValueError(
                f"path_speed must be {allowed} in split {self.split!r}, got {self.path_speed}"
            )
        if len(speeds) > 1 and PROTOCOLS[self.protocol].has_screen:
            raise ValueError(
                f"split {self.split!r} has no protocol {self.protocol!r}: screens depend on the "
                f"speed"
            )
        check_salt(self.salt)
        if len(set(self.views)) < len(self.views):
            raise ValueError(f"each view may be named once, got {', '.join(self.views)}")
        low, high = IMAGE_SIZES_PX
        if self.image_size and not low <= self.image_size <= high:
            raise ValueError(
                f"image_size must be {low} to {high} pixels, or 0 for no camera, got "
                f"{self.image_size}"
            )
        if self.environment_state == EYE and self.image_size not in (0, DETECTOR_IMAGE_SIZE_PX):
            allowed = f"{DETECTOR_IMAGE_SIZE_PX}, or 0 to show no images"
            raise ValueError(
                f"with environment_state {EYE}, image_size must be {allowed}, got {self.image_size}"
            )
        if not 0 <= self.perturbed_share <= 1:
            raise ValueError(f"perturbed_share must be 0 to 1, got {self.perturbed_share}")
        if not 0 <= self.render_noise <= MAX_RENDER_NOISE:
            raise ValueError(
                f"render_noise must be 0 to {MAX_RENDER_NOISE} levels of 255, got "
                f"{self.render_noise}"
            )
        if self.actor and not ACTOR.fullmatch(self.actor):
            raise ValueError(
                f"actor must be as `dynahoi generate --actor` writes it, TYPE@HASH, got "
                f"{self.actor!r}"
            )
        if self.actor:
            self.teacher()

    @property
    def split_definition(self) -> Split:
        """What the benchmark says of the split."""
        return BENCHMARK.splits[self.split]

    @property
    def motion_names(self) -> list[str]:
        """The kinds of motion that take turns: those listed, or those of the split that some object
        can perform.
        """
        if self.motions:
            return list(self.motions)
        objects = [OBJECTS[name] for name in self.object_names]
        return [
            name for name in self.split_definition.motions if any(map(MOTIONS[name].suits, objects))
        ]

    @property
    def object_names(self) -> list[str]:
        """The objects to draw from."""
        return list(self.objects or self.split_definition.objects)

    def stored(self) -> dict[str, Any]:
        """Return the values as datasets and results hold them: of the salt only a hash."""
        return dataclasses.asdict(self) | {"salt": seal(self.salt)}

    def changed(self, **changes: Any) -> Self:
        """Return the recipe with other values; with another capture rule come its hand and expert.

        Raises:
            ValueError: for an unknown field, or as the constructor.
        """
        known = [entry.name for entry in dataclasses.fields(self)]
        if unknown := [name for name in changes if name not in known]:
            raise ValueError(f"a recipe has no {unknown[0]!r}; its fields: {', '.join(known)}")
        if changes.get("capture", self.capture) != self.capture:
            changes = {"hand": "", "expert": ""} | changes
        return dataclasses.replace(
            self, **{k: tuple(v) if isinstance(v, list) else v for k, v in changes.items()}
        )

    def features(self) -> tuple[Feature, ...]:
        """Return the columns of the frame table of its episodes, in the dataset's order."""
        return frame_features(
            self.image_size,
            self.views,
            control_mode=self.control_mode,
            contact_sensors=CAPTURES[self.capture].uses_contact_sensors,
            environment_state=self.environment_state,
        )

    def teacher(self) -> Teacher:
        """Return the expert as a teacher.

        Raises:
            ValueError: if it cannot label whatever state somebody else gets into.
        """
        if isinstance(expert := EXPERTS[self.expert](), Teacher):
            return expert
        able = ", ".join(name for name, kind in EXPERTS.items() if issubclass(kind, Teacher))
        raise ValueError(
            f"on-policy recordings need an expert that labels any state ({able}), got "
            f"{self.expert!r} of capture rule "
            f"{self.capture!r}"
        )

    def _check_split_of(self, noun: str, name: str) -> None:
        """Refuse what the benchmark holds out for another split, and what an ``ood_`` split holds
        none of.
        """
        splits = BENCHMARK.splits_with(noun, name)
        if not splits or self.split in splits:
            return
        if "train" in splits:
            raise ValueError(
                f"split {self.split!r} holds only held-out {noun}s, got {noun} {name!r}"
            )
        raise ValueError(
            f"{noun} {name!r} is held out for split {splits[0]!r}, got split {self.split!r}"
        )

    def fingerprint(self) -> str:
        """Return 16 hexadecimal digits that identify the recipe and the code that plays it.

        The code includes the modules of motions and objects that the recipe names and somebody else
        registered.
        """
        named = [
            *(MOTIONS[name] for name in self.motions),
            *(OBJECTS[name] for name in self.objects),
        ]
        text = (
            json.dumps(self.stored(), sort_keys=True)
            + code_fingerprint()
            + extension_fingerprint(named)
        )
        return hashlib.sha256(text.encode()).hexdigest()[:16]


PLAYING = tuple(entry.name for entry in dataclasses.fields(Recipe) if entry.name not in RECORDING)
"""Fields that matter whoever plays."""


def load_recipe(path: Path | None) -> Recipe:
    """Read a recipe from YAML; the default recipe for None.

    Raises:
        ReadError: if the file does not exist, is refused by ``read_yaml`` or holds an unknown key
            or value.
    """
    if path is None:
        return Recipe()
    with reading(path):
        return decoded(Recipe, read_yaml(path))
