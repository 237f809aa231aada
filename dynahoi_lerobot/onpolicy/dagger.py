"""Dataset aggregation without a dataset: simulation, pictures and learning in one process, round after round."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.onpolicy.curriculum import Curriculum
from dynahoi_lerobot.onpolicy.late_student import acting_student
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe
from dynahoi_lerobot.onpolicy.rounds import play_round
from dynahoi_lerobot.onpolicy.run_folder import RunFolder
from dynahoi_lerobot.onpolicy.student import Learner
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

CHECKPOINT = "pretrained_model"
SCORES = ("S_loc", "S_gra", "S_joint", "S_hold")
PLAYED_SHARE = 0.5
"""Of a round's progress, what stands for playing; the updates are the rest."""
Progress = Callable[[float], object]


class Dagger:
    """A run of a recipe, which can be stopped between any two saves and goes on from the last one.

    Attributes:
        recipe: what to do.
        learner: who learns.
        round: rounds done.
        processor_s: processor time spent on them, without validations [s].
    """

    def __init__(self, recipe: DaggerRecipe, learner: Learner) -> None:
        """Prepare the worlds; a run that was stopped is taken up where it was saved last."""
        self.recipe, self.learner = recipe, learner
        self.round, self.processor_s = 0, 0.0
        self._rng = np.random.default_rng(recipe.seed)
        self._curriculum = Curriculum(recipe, self._rng)
        self._batch = WorldBatch(recipe.episodes, recipe.worlds, recipe.threads)
        self._folder = RunFolder(recipe.out, {})
        if state := self._folder.restore():
            self._resume(state)

    def run(self, progress: Progress = lambda _: None) -> Iterator[dict[str, Any]]:
        """Play and learn until all rounds are done; yield a line of the log after each.

        Args:
            progress: called with the rounds done so far, parts of them included.
        """
        while self.round < self.recipe.rounds:
            start = time.process_time()
            line = self._round(progress)
            self.processor_s += time.process_time() - start
            line["processor_minutes"] = round(self.processor_s / 60, 3)
            if self._due(self.recipe.validate_every):
                line["val"] = self._validate()
            self._folder.log(line)
            if self._due(self.recipe.save_every):
                self._save()
            yield line

    def _round(self, progress: Progress) -> dict[str, Any]:
        """Play a round and learn from all that are kept."""
        recipe = self.recipe
        share = recipe.teacher_share if self.round else 1.0

        def show(played: float) -> None:
            progress(self.round + PLAYED_SHARE * played)

        student = acting_student(self.learner, recipe.inference, self._rng)
        specs = self._curriculum.episodes(self.round)
        played = play_round(self._batch, student, specs, self._rng, share, progress=show)
        self._curriculum.note(played.episodes)
        self.learner.study(played)
        loss = self._learn(progress)
        self.round += 1
        return {"round": self.round, "loss": round(loss, 4), "train": scores(played.episodes)}

    def _learn(self, progress: Progress) -> float:
        """Update the policy and return the mean loss."""
        updates, losses = self.recipe.updates, []
        for done in range(1, updates + 1):
            losses.append(self.learner.learn(1))
            progress(self.round + PLAYED_SHARE + (1 - PLAYED_SHARE) * done / updates)
        return float(np.mean(losses))

    def _validate(self) -> dict[str, float | None]:
        """Play episodes of ``val`` without a teacher."""
        episodes, specs = replace(self.recipe.episodes, split="val"), self._validation_specs
        found: list[Episode] = []
        for first in range(0, len(specs), self.recipe.worlds):
            some = specs[first : first + self.recipe.worlds]
            batch: WorldBatch = WorldBatch(episodes, len(some), self.recipe.threads)
            rng = np.random.default_rng(0)
            student = acting_student(self.learner, self.recipe.inference, rng)
            found += play_round(batch, student, some, rng).episodes
        return scores(found)

    @cached_property
    def _validation_specs(self) -> list[EpisodeSpec]:
        return sample_specs(replace(self.recipe.episodes, split="val"), range(self.recipe.validation_episodes))

    def _due(self, every: int) -> bool:
        return self.round % every == 0 or self.round == self.recipe.rounds

    def _save(self) -> None:
        """Write the checkpoint, then what to go on from."""
        self.learner.save_pretrained(self.recipe.out / CHECKPOINT)
        state = {
            "round": self.round,
            "processor_s": self.processor_s,
            "rng": self._rng.bit_generator.state,
            "curriculum": self._curriculum.state_dict(),
            "learner": self.learner.state_dict(),
        }
        self._folder.save(state)

    def _resume(self, state: dict[str, Any]) -> None:
        self.round, self.processor_s = state["round"], state["processor_s"]
        self._rng.bit_generator.state = state["rng"]
        self._curriculum.load_state_dict(state["curriculum"])
        self.learner.load_state_dict(state["learner"])


def scores(episodes: tuple[Episode, ...] | list[Episode]) -> dict[str, float | None]:
    """Return the mean of each of ``SCORES`` in per cent, over the episodes where it is defined."""
    measured = [measure(episode) for episode in episodes]
    found = {name: [value for row in measured if (value := row[name]) is not None] for name in SCORES}
    return {name: round(100 * sum(values) / len(values), 1) if values else None for name, values in found.items()}
