"""Recipe: which episodes are drawn, under which rules."""

from dataclasses import dataclass, field
from typing import Any, Self

from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.nested import as_json, changed, leaves
from dynahoi_lerobot.core.protocols import PROTOCOLS
from dynahoi_lerobot.core.registry import known, refuse_repeated
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.benchmark import BENCHMARK, Split
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS
from dynahoi_lerobot.sampling.salt import check_salt, seal

INSTRUCTION_STYLES: tuple[str, ...] = ("reveal", "neutral", "mixed")
"""``reveal`` names object and motion, ``neutral`` the object only, ``mixed`` is either with equal
probability."""


@dataclass(frozen=True)
class Recipe:
    """Which episodes are drawn: with the seed it decides everything about an episode.

    The text of a field is also the help of the option named after it.

    Attributes:
        rules: how they play and are seen.
    """

    rules: Rules = field(default_factory=Rules)
    split: str = option(
        "train",
        "train, val, test, test_small, twins or one of the ood_ splits; selects the seed stream",
    )
    motions: tuple[str, ...] = option(
        (),
        "comma-separated kinds of motion to cycle through; by default those of the split. "
        "Registered motions outside the benchmark must be named here",
    )
    objects: tuple[str, ...] = option(
        (), "comma-separated objects to sample from; by default those of the split"
    )
    path_speed: float = option(
        1.0,
        "speed factor along the target's path: 1, or in split twins also 1.6",
        compared=True,
    )
    instructions: str = option(
        "mixed",
        "whether language instructions name the motion: reveal, neutral or mixed",
        compared=True,
    )
    appearance: tuple[str, ...] = option(
        (),
        "comma-separated visual randomizations beyond the training distribution: materials, "
        "lights, specular, transparency, distractors",
        compared=True,
    )
    salt: str = option(
        "",
        "secret text that selects hidden episodes of the same benchmark; only its hash is stored",
        repr=False,
    )

    def __post_init__(self) -> None:
        """Check every name against what exists.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        known("split", self.split, BENCHMARK.splits)
        known("instructions", self.instructions, dict.fromkeys(INSTRUCTION_STYLES))
        for name in self.appearance:
            known("appearance", name, RANDOMIZATIONS)
        for noun, registry, chosen in (
            ("motion", MOTIONS, self.motions),
            ("object", OBJECTS, self.objects),
        ):
            refuse_repeated(noun, chosen)
            for name in chosen:
                registry[name]  # raises if there is none
                self._check_split_of(noun, name)
        speeds = self.split_definition.path_speeds
        if self.path_speed not in speeds:
            allowed = ", ".join(f"{speed:g}" for speed in speeds)
            raise ValueError(
                f"path_speed must be {allowed} in split {self.split!r}, got {self.path_speed}"
            )
        if len(speeds) > 1 and PROTOCOLS[self.rules.protocol].has_screen:
            raise ValueError(
                f"split {self.split!r} has no protocol {self.rules.protocol!r}: screens depend on "
                f"the speed"
            )
        check_salt(self.salt)

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Return a recipe with values for some of its fields and of those of its rules.

        Raises:
            ValueError: for an unknown name, or as the constructors.
        """
        return changed(cls(), values)

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
        return as_json(self) | {"rules": self.rules.stored(), "salt": seal(self.salt)}

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


COMPARED = tuple(entry.name for _, entry in leaves(Recipe) if "compared" in entry.metadata)
"""Fields of the recipe and its rules in which two evaluations must agree for their scores to be
compared."""
