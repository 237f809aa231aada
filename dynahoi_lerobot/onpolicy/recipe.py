"""How a policy is trained in memory, as YAML files that draccus reads."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import draccus

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.yaml_file import read_yaml
from dynahoi_lerobot.rollout.inference import RTC, SYNC, Inference
from dynahoi_lerobot.sampling.recipe import Recipe


@dataclass(frozen=True)
class EyeRecipe:
    """How an eye is trained on random configurations.

    Attributes:
        out: folder that receives ``eye.safetensors``, ``log.jsonl`` and what a killed run resumes from.
        camera: whose images it sees, ``ego`` or ``side``.
        eye: options of ObAct's ``Eye``, such as ``weights`` to start from.
        device: of the training.
        episodes: what the images show.
        n_episodes: how many different episodes they show.
        randomized_share: share of those whose appearance is randomised in every way, see ``randomization``.
        images: images in all, each seen once.
        batch_size: images in an update.
        learning_rate: of AdamW, with a warm-up and cosine decay.
        save_every: updates between saves. After each the images come from a new stream of random numbers, so that a
            resumed run sees the same ones as a run that was never killed.
        seed: of every draw.
    """

    out: Path
    camera: str = EGO_VIEW
    eye: dict[str, Any] = field(default_factory=dict)
    device: str = "cpu"
    episodes: Recipe = field(default_factory=lambda: Recipe(image_size=64))
    n_episodes: int = 1024
    randomized_share: float = 0.0
    images: int = 400_000
    batch_size: int = 128
    learning_rate: float = 2e-3
    save_every: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        """Check what could only fail after minutes.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        _check_counts(self, "n_episodes", "batch_size", "save_every")
        _check_share(self, "randomized_share")
        if self.images < self.batch_size:
            raise ValueError(f"images must be at least batch_size, {self.batch_size}, got {self.images}")


@dataclass(frozen=True)
class StudentInference:
    """How long the student's inferences take while it acts, see `Inference`.

    Attributes:
        mode: ``sync`` or ``async``.
        latency_ms: latency of all episodes, or the least and the greatest: each episode has its own in between [ms].
        corrected: whether the student corrects its running chunk in every frame.
    """

    mode: str = SYNC
    latency_ms: float | tuple[float, float] = 0.0
    corrected: bool = False

    def __post_init__(self) -> None:
        """Check mode and latencies.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        if self.mode == RTC:
            raise ValueError("inference.mode must be sync or async, got rtc: a student is not guided")
        low, high = self.range_ms
        _ = Inference(self.mode, low), Inference(self.mode, high, self.corrected)
        if low > high:
            raise ValueError(f"inference.latency_ms must rise, got {low:g} to {high:g}")

    @property
    def range_ms(self) -> tuple[float, float]:
        """Least and greatest latency [ms]."""
        return self.latency_ms if isinstance(self.latency_ms, tuple) else (self.latency_ms, self.latency_ms)


@dataclass(frozen=True)
class DaggerRecipe:
    """How a policy learns from a teacher in the states that it gets into by itself (Ross et al., 2011).

    Attributes:
        out: folder that receives the checkpoint, ``log.jsonl`` and what a stopped run goes on from.
        policy: fields of the policy's config, ``type`` among them.
        start: checkpoint whose weights training starts from; empty for none.
        episodes: what is played.
        inference: whether the world waits for the student's inferences, or how long they take.
        rounds: rounds in all; in the first the teacher leads all episodes.
        worlds: episodes in a round.
        threads: of the physics, 0 for all cores; without influence on the result.
        n_episodes: how many different episodes are played; they come in the order of their seeds, then at random.
        teacher_share: share of episodes that the teacher leads, disturbed.
        updates: updates after each round.
        batch_episodes: whole episodes in an update.
        rounds_kept: how many of the last rounds are learned from.
        learning_rate: of AdamW, with a warm-up and cosine decay.
        save_every: rounds between saves.
        validate_every: rounds between validations.
        validation_episodes: how many episodes of ``val`` a validation plays; its processor time is not counted.
        seed: of every draw.
    """

    out: Path
    policy: dict[str, Any]
    start: str = ""
    episodes: Recipe = field(default_factory=lambda: Recipe(image_size=64))
    inference: StudentInference = field(default_factory=StudentInference)
    rounds: int = 60
    worlds: int = 64
    threads: int = 1
    n_episodes: int = 1536
    teacher_share: float = 0.15
    updates: int = 24
    batch_episodes: int = 32
    rounds_kept: int = 40
    learning_rate: float = 1.5e-3
    save_every: int = 5
    validate_every: int = 15
    validation_episodes: int = 110
    seed: int = 0

    def __post_init__(self) -> None:
        """Check what could only fail after minutes.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        _check_counts(
            self, "rounds", "worlds", "updates", "batch_episodes", "rounds_kept", "save_every", "validate_every"
        )
        if self.n_episodes < self.worlds:
            raise ValueError(f"n_episodes must be at least worlds, {self.worlds}, got {self.n_episodes}")
        if self.threads < 0:
            raise ValueError(f"threads must be 0 or more, got {self.threads}")
        _check_share(self, "teacher_share")
        if self.episodes.split != "train":
            raise ValueError(f"episodes.split must be train, got {self.episodes.split}")


def _check_counts(recipe: EyeRecipe | DaggerRecipe, *names: str) -> None:
    for name in names:
        if getattr(recipe, name) < 1:
            raise ValueError(f"{name} must be 1 or more, got {getattr(recipe, name)}")


def _check_share(recipe: EyeRecipe | DaggerRecipe, name: str) -> None:
    if not 0 <= getattr(recipe, name) <= 1:
        raise ValueError(f"{name} must be 0 to 1, got {getattr(recipe, name)}")


def read_recipe[R: (EyeRecipe, DaggerRecipe)](kind: type[R], path: Path, **changes: Any) -> R:
    """Read a recipe from YAML, with some values changed.

    Raises:
        ValueError: if the file is refused by ``read_yaml``, or holds an unknown key or value.
    """
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise ValueError(f"{path} must map keys to values, got a {type(values).__name__}")
    try:
        return draccus.decode(kind, values | {name: str(value) for name, value in changes.items()})
    except draccus.utils.DraccusException as error:
        raise ValueError(f"{path}: {error.__cause__ or error}") from error
