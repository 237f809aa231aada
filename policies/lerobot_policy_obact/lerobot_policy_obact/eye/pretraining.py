"""Pretraining of the eye on images of random configurations, which `dynahoi pretrain` runs."""

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import draccus
import torch
from einops import rearrange
from safetensors.torch import save_file
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.reading import reading
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.snapshots import ImageStream, calibration

from ..camera import Pinhole
from ..encoders import Eye
from .run_folder import STATE, RunFolder, check_moments, check_progress

WEIGHTS = "eye.safetensors"
HEAT_WEIGHT = 0.3
"""Weight of the cross-entropy of the cell that is attended to; only at first is it large."""
LIKELIHOOD_WEIGHT = 0.1
"""Weight of the likelihood, which teaches how sure a sighting is; the errors themselves teach where
the target is."""
ERROR_M = 0.05
ERROR_SHARE = 0.3
"""Errors in meters count in units of this much, and of this share of the distance more: what is
farther away can be known less well."""
LARGEST_ERROR = 4.0  # of these units: an eye that looks at something else learns no more from it
WARMUP_UPDATES = 200
FINAL_LR_SHARE = 0.02  # of the learning rate, to which a cosine decays it
GRADIENT_CLIP = 5.0
"""No number above was tuned."""


def sighting_loss(eye: Eye, camera: Pinhole, images: Tensor, place: Tensor) -> Tensor:
    """Return the loss of each image: attention, Laplace likelihood of direction and depth, and
    error in meters.

    Args:
        eye: whose loss it is.
        camera: whose images these are.
        images: RGB in [0, 1] with the images before, ``(F, 6, H, W)``.
        place: where the target is, relative to the camera's origin [m], world axes, ``(F, 3)``.
    """
    sighting, heat = eye.look(images)
    seen = sighting[:, :3]
    scales = sighting[:, 3:5]
    true = camera.project(place)
    across = (seen[:, :2] - true[:, :2]).square().sum(-1).add(1e-8).sqrt()
    along = (seen[:, 2] - true[:, 2]).abs()
    error = torch.stack([across, along], dim=-1)  # (F, 2)
    likelihood = (error * (-scales).exp() + scales * scales.new_tensor([2.0, 1.0])).sum(-1)
    unit_m = ERROR_M + ERROR_SHARE * place.norm(dim=-1)
    metric = ((camera.unproject(seen) - place).norm(dim=-1) / unit_m).clamp_max(LARGEST_ERROR)
    found = HEAT_WEIGHT * _heat_loss(heat, true)
    return found + LIKELIHOOD_WEIGHT * likelihood + across + along + metric


def _heat_loss(heat: Tensor, true: Tensor) -> Tensor:
    """Return the cross-entropy of the cell that the target is in, 0 where it is out of view,
    ``(F,)``.
    """
    size = true.new_tensor([heat.shape[-1], heat.shape[-2]])
    place = ((true[:, :2] * true.new_tensor([1.0, -1.0]) + 1) / 2 * size).floor().long()
    cell = torch.minimum(place.clamp_min(0), size.long() - 1)
    return -heat[torch.arange(len(heat)), cell[:, 1], cell[:, 0]] * (place == cell).all(-1)


class RenderedImages(IterableDataset):
    """What an eye is shown in the updates from ``first`` on: images ``(F, H, W, 6)`` uint8 and
    places ``(F, 3)`` [m].

    Several workers take turns. Each begins a new stream of random numbers after every save.
    """

    def __init__(self, recipe: PretrainRecipe, first: int) -> None:
        self._recipe = recipe
        self._first = first

    def __iter__(self) -> Iterator[tuple[Any, Any]]:
        """Yield those of this worker."""
        info = get_worker_info()
        every = self._recipe.save_every
        turn, n_workers = (0, 1) if info is None else (info.id, info.num_workers)
        stream = ImageStream(self._recipe, (self._first + turn) % n_workers, n_workers)
        for save, updates in groupby(
            range(self._first + turn, self._recipe.updates, n_workers), lambda i: i // every
        ):
            for _, shown in zip(updates, stream(save * every), strict=False):
                yield shown.images, shown.place


class Training:
    """A run of a recipe on images seen once each, which can be killed at any time and resumed from
    its last save.

    However often it is killed, it ends with the same weights to the bit on the same machine: every
    save begins a new stream of images, and after the first weights nothing else is drawn.

    Args:
        recipe: what to do.

    Attributes:
        n_updates: done so far.
    """

    def __init__(self, recipe: PretrainRecipe) -> None:
        torch.manual_seed(recipe.seed)
        self.recipe = recipe
        try:
            eye = Eye(**recipe.eye)
            eye.load_pretrained()
            self._eye = eye.to(recipe.device)
        # whatever options and devices that do not exist make torch raise
        except Exception as error:
            raise ValueError(
                f"eye is {recipe.eye} on {recipe.device!r}, which cannot be made: {error}"
            ) from error
        pose, (focal_px, _, center_px, _) = calibration(recipe)
        carried = recipe.camera == EGO_VIEW
        self._camera = Pinhole.from_pose(pose.tolist(), center_px / focal_px, carried=carried).to(
            recipe.device
        )
        self.optimizer = torch.optim.AdamW(eye.parameters(), lr=0.0, weight_decay=1e-4)
        self.n_updates = 0
        self._spent_s = 0.0
        self._folder = RunFolder(recipe.out, draccus.encode(replace(recipe, out=Path())))
        with reading(recipe.out / STATE):
            state = self._folder.restore()
            if state:
                check_progress(state, recipe.updates)
                self._eye.load_state_dict(state["weights"])
                check_moments(state, self._eye.parameters())
                self.n_updates = state["updates"]
                self._spent_s = state["processor_s"]
                # the recipe's groups, whatever the file says
                groups = self.optimizer.state_dict()["param_groups"]
                moments = state["optimizer"]["state"]
                self.optimizer.load_state_dict({"state": moments, "param_groups": groups})

    @property
    def finished(self) -> bool:
        """Whether all images have been seen."""
        return self.n_updates >= self.recipe.updates

    def run(self) -> Iterator[dict[str, Any]]:
        """Learn until all images have been seen, then write the weights; yield a line of the log
        after each save.

        The weights are for the option ``weights`` of `Eye`. Raises what ``update`` raises.
        """
        recipe = self.recipe
        losses = []
        shown = RenderedImages(recipe, self.n_updates)
        # a process that is forked from one that uses CUDA cannot use it
        context = "spawn" if recipe.workers else None
        for images, place in DataLoader(
            shown, None, num_workers=recipe.workers, multiprocessing_context=context
        ):
            losses.append(self.update(images, place))
            if self.n_updates % recipe.save_every and not self.finished:
                continue
            minutes = round(self._processor_s() / 60, 3)
            line = {"images": self.n_updates * recipe.batch_size, "processor_minutes": minutes}
            line["loss"] = round(sum(losses) / len(losses), 4)
            losses.clear()
            self._folder.log(line)
            self._save()
            yield line
        write_atomically(
            {self.recipe.out / WEIGHTS: lambda path: save_file(self._eye.state_dict(), path)}
        )
        self._folder.release()

    def update(self, shown: Tensor, place: Tensor) -> float:
        """Take one step on images ``(F, H, W, 6)`` of targets at ``place`` ``(F, 3)`` [m], and
        return its loss.

        Raises:
            FloatingPointError: if the loss is not finite; no weight has changed then.
        """
        device = self.recipe.device
        images = rearrange(shown.to(device), "f h w c -> f c h w") / 255.0
        loss = sighting_loss(self._eye, self._camera, images, place.to(device)).mean()
        if not math.isfinite(value := loss.item()):
            raise FloatingPointError(
                f"the loss of update {self.n_updates} is {value}; lower learning_rate"
            )
        progress = self.n_updates / self.recipe.updates
        cosine = FINAL_LR_SHARE + (1 - FINAL_LR_SHARE) / 2 * (1 + math.cos(math.pi * progress))
        rate = min(1.0, (self.n_updates + 1) / WARMUP_UPDATES) * cosine
        for group in self.optimizer.param_groups:
            group["lr"] = self.recipe.learning_rate * rate
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._eye.parameters(), GRADIENT_CLIP)
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
                "weights": self._eye.state_dict(),
                "optimizer": self.optimizer.state_dict(),
            }
        )
