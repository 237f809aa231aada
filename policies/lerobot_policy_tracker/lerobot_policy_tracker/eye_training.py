"""Training an eye: each picture is seen once, so there is nothing to overfit to."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import draccus
import torch
from lerobot.configs import PreTrainedConfig
from .eye import sighting_loss
from safetensors.torch import save_file

from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.onpolicy.run_folder import RunFolder

from .backbones import backbones
from .backbones.eye import EyeBackbone
from .updates import learning_rate, take_step

if TYPE_CHECKING:
    from dynahoi_lerobot.onpolicy.recipe import EyeRecipe
    from dynahoi_lerobot.onpolicy.snapshots import Snapshots

WARMUP_UPDATES = 200
WEIGHTS = "eye.safetensors"
GRADIENT_CLIP = 5.0

Pictures = Callable[[int], Iterator["Snapshots"]]
"""The pictures from an update on, a batch for each; of an update that a run goes on from they are always the same."""


class EyeTraining:
    """A run of a recipe, which can be killed at any time and goes on from its last save.

    It ends with the same weights to the bit, on the same machine, however often it was killed: every save, also of a
    run that goes on, begins a new stream of pictures, and after the first weights nothing else is drawn.

    Attributes:
        recipe: what to do.
        eye: who learns.
        n_updates: done so far.
    """

    def __init__(self, recipe: EyeRecipe) -> None:
        """Build the eye of the recipe's policy on its device; a run that was killed goes on where it was saved last.

        Raises:
            BlockingIOError: if another process works in the folder.
            FileExistsError: if the folder holds a run of another recipe, or no run made it.
        """
        torch.manual_seed(recipe.seed)
        self.recipe = recipe
        options = recipe.policy.get("backbone_options", {}) | {"frozen": False}
        self.eye: EyeBackbone = backbones.build("eye", recipe.policy.get("width", 128), options=options)
        self.eye.load_pretrained()
        self.eye.to(draccus.decode(PreTrainedConfig, {"device": "cpu"} | recipe.policy).device)
        self.optimizer = torch.optim.AdamW(self.eye.parameters(), lr=0.0, weight_decay=1e-4)
        self.n_updates, self._spent_s = 0, 0.0
        self._folder = RunFolder(recipe.out, _as_stored(recipe))
        if state := self._folder.restore():
            self._resume(state)

    @property
    def finished(self) -> bool:
        """Whether all pictures have been seen."""
        return self.n_updates >= self._all_updates

    @property
    def _all_updates(self) -> int:
        return self.recipe.pictures // self.recipe.batch_size

    def run(self, pictures: Pictures) -> Iterator[dict[str, Any]]:
        """Learn until all pictures have been seen, then write the weights; yield a line of the log after each save.

        Raises:
            FloatingPointError: if the loss is not finite.
        """
        while not self.finished:
            ahead = min(self.recipe.save_every, self._all_updates - self.n_updates)
            losses = [self._update(shown) for shown in _prefetched(islice(pictures(self.n_updates), ahead))]
            seen, minutes = self.n_updates * self.recipe.batch_size, round(self._processor_s() / 60, 3)
            line = {"pictures": seen, "processor_minutes": minutes, "loss": round(sum(losses) / len(losses), 4)}
            self._folder.log(line)
            self._save()
            yield line
        write_atomically({self.recipe.out / WEIGHTS: lambda path: save_file(self.eye.learned_state(), path)})
        self._folder.release()

    def _update(self, shown: Snapshots) -> float:
        recipe, n = self.recipe, self.n_updates
        device = self.eye.heat.weight.device
        images = torch.from_numpy(shown.images).to(device).permute(0, 3, 1, 2) / 255.0  # (F, 6, H, W)
        loss = sighting_loss(self.eye, images, torch.from_numpy(shown.place).to(device)).mean()
        rate = learning_rate(recipe.learning_rate, n, self._all_updates, WARMUP_UPDATES)
        self.n_updates += 1
        return take_step(self.optimizer, loss, self.eye.parameters(), max_norm=GRADIENT_CLIP, rate=rate, n=n)

    def _processor_s(self) -> float:
        """Processor time of this process, and of those before it until they saved last [s]."""
        return self._spent_s + time.process_time()

    def _save(self) -> None:
        state = {
            "updates": self.n_updates,
            "processor_s": self._processor_s(),
            "eye": self.eye.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        self._folder.save(state)

    def _resume(self, state: dict[str, Any]) -> None:
        self.n_updates, self._spent_s = state["updates"], state["processor_s"]
        self.eye.load_state_dict(state["eye"])
        self.optimizer.load_state_dict(state["optimizer"])


def _prefetched(pictures: Iterator[Snapshots]) -> Iterator[Snapshots]:
    """Yield the same pictures, rendering the next batch on another core while one is learned from."""
    with ThreadPoolExecutor(max_workers=1) as renderer:
        coming = renderer.submit(next, pictures, None)
        while (shown := coming.result()) is not None:
            coming = renderer.submit(next, pictures, None)
            yield shown


def _as_stored(recipe: EyeRecipe) -> dict[str, Any]:
    """Return all that decides the weights, as plain values."""
    return draccus.encode(replace(recipe, out=Path()))
