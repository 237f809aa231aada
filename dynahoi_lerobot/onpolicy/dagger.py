"""Dataset aggregation without a dataset: simulation, pictures and learning in one process, round after round."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe
from dynahoi_lerobot.onpolicy.rounds import play_round
from dynahoi_lerobot.onpolicy.student import Learner
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

CHECKPOINT, LOG, STATE = "pretrained_model", "log.jsonl", "state.pt"
SCORES = ("S_loc", "S_gra", "S_joint")
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
        self._batch = make_batch(recipe.episodes, recipe.worlds, threads=1)
        self._specs: dict[int, EpisodeSpec] = {}
        recipe.out.mkdir(parents=True, exist_ok=True)
        if (recipe.out / STATE).exists():
            self._resume()

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
            self._log(line)
            if self._due(self.recipe.save_every):
                self._save()
            yield line

    def _round(self, progress: Progress) -> dict[str, Any]:
        """Play a round and learn from all that are kept."""
        recipe = self.recipe
        share = recipe.teacher_share if self.round else 1.0

        def show(played: float) -> None:
            progress(self.round + PLAYED_SHARE * played)

        played = play_round(self._batch, self.learner, self._next_specs(), self._rng, share, progress=show)
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

    def _next_specs(self) -> list[EpisodeSpec]:
        """Return the episodes of the next round: new ones as long as there are any, then a draw from all."""
        recipe = self.recipe
        first = self.round * recipe.worlds
        if first + recipe.worlds <= recipe.n_episodes:
            seeds = np.arange(first, first + recipe.worlds)
        else:
            seeds = np.sort(self._rng.choice(recipe.n_episodes, recipe.worlds, replace=False))
        missing = [int(seed) for seed in seeds if int(seed) not in self._specs]
        self._specs |= zip(missing, sample_specs(recipe.episodes, missing), strict=True)
        return [self._specs[int(seed)] for seed in seeds]

    def _validate(self) -> dict[str, float | None]:
        """Play episodes of ``val`` without a teacher."""
        episodes = replace(self.recipe.episodes, split="val")
        specs = sample_specs(episodes, range(self.recipe.validation_episodes))
        found: list[Episode] = []
        for first in range(0, len(specs), self.recipe.worlds):
            some = specs[first : first + self.recipe.worlds]
            batch: WorldBatch = make_batch(episodes, len(some), threads=1)
            found += play_round(batch, self.learner, some, np.random.default_rng(0)).episodes
        return scores(found)

    def _due(self, every: int) -> bool:
        return self.round % every == 0 or self.round == self.recipe.rounds

    def _log(self, line: dict[str, Any]) -> None:
        with (self.recipe.out / LOG).open("a") as file:
            file.write(json.dumps(line) + "\n")

    def _save(self) -> None:
        """Write the checkpoint, and what to go on from, in that order and each at once."""
        import torch

        self.learner.save_pretrained(self.recipe.out / CHECKPOINT)
        state = {
            "round": self.round,
            "processor_s": self.processor_s,
            "rng": self._rng.bit_generator.state,
            "learner": self.learner.state_dict(),
            "log": (self.recipe.out / LOG).read_text(),
        }
        unfinished = self.recipe.out / f"{STATE}.unfinished"
        torch.save(state, unfinished)
        os.replace(unfinished, self.recipe.out / STATE)

    def _resume(self) -> None:
        import torch

        state = torch.load(self.recipe.out / STATE, weights_only=True)
        self.round, self.processor_s = state["round"], state["processor_s"]
        self._rng.bit_generator.state = state["rng"]
        self.learner.load_state_dict(state["learner"])
        (self.recipe.out / LOG).write_text(state["log"])  # drops the lines of rounds that were not saved


def scores(episodes: tuple[Episode, ...] | list[Episode]) -> dict[str, float | None]:
    """Return the mean of each of ``SCORES`` in per cent, over the episodes where it is defined."""
    measured = [measure(episode) for episode in episodes]
    found = {name: [value for row in measured if (value := row[name]) is not None] for name in SCORES}
    return {name: round(100 * sum(values) / len(values), 1) if values else None for name, values in found.items()}
