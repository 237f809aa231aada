"""Recording: who plays the episodes of a recipe for a dataset, and what of them is kept; as a YAML
file.
"""

import dataclasses
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from dynahoi_lerobot.core.agent import Expert
from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.nested import as_json, changed, field_names, flat, nested
from dynahoi_lerobot.core.reading import decoded, read_yaml, reading
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.sampling.recipe import Recipe

ACTOR = re.compile(r"[a-z0-9_]+@[0-9a-f]{16}")


@dataclass(frozen=True)
class Recording:
    """What a dataset is recorded from.

    The text of a field is also the help of the option named after it.

    Attributes:
        recipe: which episodes.
        actor: policy that moves the hand while the expert labels its states, TYPE@HASH of its
            checkpoint; empty if the expert demonstrates. Its failures are always kept.
    """

    recipe: Recipe = field(default_factory=Recipe)
    expert: str = option("", "demonstrating expert; by default the capture rule's")
    perturbed_share: float = option(
        0.5,
        "share of episodes in which the palm is pushed off course at times, if the expert can "
        "recover",
    )
    keep_failures: bool = option(
        False, "also store episodes in which the expert fails, instead of replacing them"
    )
    actor: str = ""

    def __post_init__(self) -> None:
        """Check the names and the share.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        EXPERTS.check(self.expert_name)
        if not 0 <= self.perturbed_share <= 1:
            raise ValueError(f"perturbed_share must be 0 to 1, got {self.perturbed_share}")
        if len(self.recipe.split_definition.path_speeds) > 1:
            raise ValueError(f"split {self.recipe.split!r} is for evaluations; record another one")
        if self.actor and not ACTOR.fullmatch(self.actor):
            raise ValueError(
                f"actor must be as `dynahoi generate --actor` writes it, TYPE@HASH, got "
                f"{self.actor!r}"
            )
        if self.actor:
            self.teacher()

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Return a recording with values for some fields of its own, of its recipe and of its
        rules.

        Raises:
            ValueError: for an unknown name, or as the constructors.
        """
        return changed(cls(), values)

    @property
    def expert_name(self) -> str:
        """The expert that demonstrates, or labels the states of the actor."""
        return self.expert or self.recipe.rules.capture_rule.expert

    def teacher(self) -> Expert:
        """Return the expert as a teacher.

        Raises:
            ValueError: if it cannot label whatever state somebody else gets into.
        """
        expert = EXPERTS[self.expert_name]()
        if expert.labels_any_state:
            return expert
        able = ", ".join(name for name, kind in EXPERTS.items() if kind.labels_any_state)
        raise ValueError(
            f"on-policy recordings need an expert that labels any state ({able}), got "
            f"{self.expert_name!r} of capture rule {self.recipe.rules.capture!r}"
        )

    def stored(self) -> dict[str, Any]:
        """Return the values as datasets hold them, with the expert named."""
        return as_json(self) | {
            "recipe": self.recipe.stored(),
            "expert": self.expert_name,
        }


def read_recording(path: Path) -> dict[str, Any]:
    """Read values of fields of `Recording`, and of what is in it, from a YAML file, whose keys are
    their names.

    Raises:
        ReadError: if the file does not exist, is refused by ``read_yaml`` or holds an unknown key
            or value.
    """
    with reading(path):
        values = read_yaml(path)
        for name in values:
            known("key", name, dict.fromkeys(field_names(Recording)))
        read = decoded(Recording, nested(Recording, values))
        decided = flat(dataclasses.asdict(read))
        return {name: decided[name] for name in values}


def load_recording(path: Path) -> Recording:
    """Return the recording that a YAML file describes; ReadError as ``read_recording``."""
    return changed(Recording(), read_recording(path))
