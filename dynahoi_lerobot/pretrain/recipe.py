"""What is pretrained and how, as a YAML file that draccus reads."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.nested import nested
from dynahoi_lerobot.core.reading import decoded, read_yaml, reading
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.renderers.views import CAMERAS
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe


@dataclass(frozen=True)
class PretrainRecipe:
    """How an eye is trained on random configurations.

    Attributes:
        out: folder that receives the weights, ``log.jsonl`` and the state of a killed run.
        camera: whose images it sees, ``ego`` or ``side``.
        eye: options of ObAct's ``Eye``, such as ``weights`` to start from.
        device: of the training.
        workers: processes that render; 0 renders between the updates, in the training's own.
        episodes: the episodes that the images show.
        hands: names of the hands that take turns from update to update; none for the hand of
            ``episodes``.
        n_episodes: how many different episodes are shown, with each hand.
        randomized_share: share of those whose appearance is randomized in every way, see
            ``randomization``.
        images: images in all, each seen once.
        batch_size: images in an update.
        learning_rate: of AdamW, with a warm-up and cosine decay.
        save_every: updates between saves. After each the images come from a new stream of random
            numbers, so that a resumed run sees the same ones as a run that was never killed.
        seed: of every draw.
    """

    out: Path
    camera: str = EGO_VIEW
    eye: dict[str, Any] = field(default_factory=dict)
    device: str = "cpu"
    workers: int = 0
    episodes: Recipe = field(default_factory=lambda: Recipe(rules=Rules(image_size=64)))
    hands: tuple[str, ...] = ()
    n_episodes: int = 1024
    randomized_share: float = 0.0
    images: int = 400_000
    batch_size: int = 128
    learning_rate: float = 2e-3
    save_every: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        """Check what could only fail after minutes; ValueError naming the value received and the
        ones allowed.
        """
        if self.camera not in CAMERAS:
            raise ValueError(f"camera must be {' or '.join(CAMERAS)}, got {self.camera}")
        for name in ("n_episodes", "batch_size", "save_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)}")
        if not 0 <= self.randomized_share <= 1:
            raise ValueError(f"randomized_share must be 0 to 1, got {self.randomized_share}")
        if self.images < self.batch_size:
            raise ValueError(
                f"images must be at least batch_size, {self.batch_size}, got {self.images}"
            )
        if self.workers < 0:
            raise ValueError(f"workers must be 0 or more, got {self.workers}")

    @property
    def updates(self) -> int:
        """Updates in all."""
        return self.images // self.batch_size


def read_recipe(path: Path, **changes: Any) -> PretrainRecipe:
    """Read a recipe from YAML, with some values changed.

    Raises:
        ReadError: if the file is refused by ``read_yaml``, or holds an unknown key or value.
        ValueError: if a recipe has no value of that name.
    """
    names = dict.fromkeys(entry.name for entry in fields(PretrainRecipe))
    for name in changes:
        known("field of the recipe", name, names)
    with reading(path):
        values = read_yaml(path) | changes
        if isinstance(values.get("episodes"), dict):
            values["episodes"] = nested(Recipe, values["episodes"])
        return decoded(PretrainRecipe, values)
