"""Training on images of random configurations, for `dynahoi pretrain`: each image is seen once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import draccus
import torch
from einops import rearrange
from torch import Tensor, nn

from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.run_folder import RunFolder
from dynahoi_lerobot.pretrain.snapshots import ImageStream, Snapshots

WARMUP_UPDATES, GRADIENT_CLIP = 200, 5.0


class Learner(Protocol):
    """What is trained."""

    @property
    def module(self) -> nn.Module:
        """Holds the weights that are learned."""
        ...

    def loss(self, images: Tensor, place: Tensor) -> Tensor:
        """Return the loss of each image, ``(F,)``.

        Args:
            images: RGB in [0, 1] with the images before, ``(F, 6, H, W)``.
            place: where the target is [m], ``(F, 3)``, see `Snapshots`.
        """
        ...

    def save(self, folder: Path) -> None:
        """Write what a policy starts from."""
        ...


class Training:
    """A run of a recipe, which can be killed at any time and resumed from its last save.

    However often it is killed, it ends with the same weights to the bit on the same machine: every save begins a new
    stream of images, and after the first weights nothing else is drawn.

    Args:
        recipe: what to do.
        images: what is shown.
        learner: makes what is trained from ``recipe`` and ``images``.

    Attributes:
        learner: what is trained.
        n_updates: done so far.

    Raises:
        BlockingIOError: if another process works in the folder.
        FileExistsError: if the folder holds a run of another recipe, or no run made it.
    """

    def __init__(
        self, recipe: PretrainRecipe, images: ImageStream, learner: Callable[[PretrainRecipe, ImageStream], Learner]
    ) -> None:
        torch.manual_seed(recipe.seed)
        self.recipe, self._images, self.learner = recipe, images, learner(recipe, images)
        self._module = self.learner.module.to(recipe.device)
        self.optimizer = torch.optim.AdamW(self._module.parameters(), lr=0.0, weight_decay=1e-4)
        self.n_updates, self._spent_s = 0, 0.0
        self._folder = RunFolder(recipe.out, draccus.encode(replace(recipe, out=Path())))
        if state := self._folder.restore():
            self.n_updates, self._spent_s = state["updates"], state["processor_s"]
            self._module.load_state_dict(state["weights"])
            self.optimizer.load_state_dict(state["optimizer"])

    @property
    def finished(self) -> bool:
        """Whether all images have been seen."""
        return self.n_updates >= self._all_updates

    @property
    def _all_updates(self) -> int:
        return self.recipe.images // self.recipe.batch_size

    def run(self) -> Iterator[dict[str, Any]]:
        """Learn until all images have been seen, then write the weights; yield a line of the log after each save.

        Raises:
            FloatingPointError: if the loss is not finite.
        """
        while not self.finished:
            ahead = min(self.recipe.save_every, self._all_updates - self.n_updates)
            losses = [self.update(shown) for shown in _prefetched(islice(self._images(self.n_updates), ahead))]
            minutes = round(self._processor_s() / 60, 3)
            line = {"images": self.n_updates * self.recipe.batch_size, "processor_minutes": minutes}
            line["loss"] = round(sum(losses) / len(losses), 4)
            self._folder.log(line)
            self._save()
            yield line
        self.learner.save(self.recipe.out)
        self._folder.release()

    def update(self, shown: Snapshots) -> float:
        """Take one step on a batch of images, and return its loss.

        Raises:
            FloatingPointError: if the loss is not finite; no weight has changed then.
        """
        device = self.recipe.device
        images = rearrange(torch.from_numpy(shown.images).to(device), "f h w c -> f c h w") / 255.0
        loss = self.learner.loss(images, torch.from_numpy(shown.place).to(device)).mean()
        if not math.isfinite(value := loss.item()):
            raise FloatingPointError(f"the loss of update {self.n_updates} is {value}; lower learning_rate")
        progress = self.n_updates / self._all_updates
        rate = min(1.0, (self.n_updates + 1) / WARMUP_UPDATES) * (0.02 + 0.49 * (1 + math.cos(math.pi * progress)))
        for group in self.optimizer.param_groups:
            group["lr"] = self.recipe.learning_rate * rate
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._module.parameters(), GRADIENT_CLIP)
        self.optimizer.step()
        self.n_updates += 1
        return value

    def _processor_s(self) -> float:
        """Processor time of this process, and of those before it until their last save [s]."""
        return self._spent_s + time.process_time()

    def _save(self) -> None:
        self._folder.save(
            {
                "updates": self.n_updates,
                "processor_s": self._processor_s(),
                "weights": self._module.state_dict(),
                "optimizer": self.optimizer.state_dict(),
            }
        )


def _prefetched(images: Iterator[Snapshots]) -> Iterator[Snapshots]:
    """Yield the same images, rendering the next batch on another core while one is learned from."""
    with ThreadPoolExecutor(max_workers=1) as renderer:
        coming = renderer.submit(next, images, None)
        while (shown := coming.result()) is not None:
            coming = renderer.submit(next, images, None)
            yield shown
