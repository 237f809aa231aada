"""Pretraining of the eye on images of random configurations, which `dynahoi pretrain` runs."""

import json
import math
import time
import weakref
from collections.abc import Iterator
from contextlib import ExitStack
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
from dynahoi_lerobot.core.reading import read_text, reading, regular
from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.snapshots import ImageStream, calibration

from ..camera import Pinhole
from ..encoders import Eye

WEIGHTS, LOG, STATE = "eye.safetensors", "log.jsonl", "state.pt"
STATE_TYPES = {
    "updates": int,
    "processor_s": float,
    "weights": dict,
    "optimizer": dict,
    "log": str,
}
"""What a saved state holds."""
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
GRADIENT_CLIP = 5.0


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
    true = camera.seen(place)
    across = (seen[:, :2] - true[:, :2]).square().sum(-1).add(1e-8).sqrt()
    along = (seen[:, 2] - true[:, 2]).abs()
    error = torch.stack([across, along], dim=-1)  # (F, 2)
    likelihood = (error * (-scales).exp() + scales * scales.new_tensor([2.0, 1.0])).sum(-1)
    unit_m = ERROR_M + ERROR_SHARE * place.norm(dim=-1)
    metric = ((camera.place(seen) - place).norm(dim=-1) / unit_m).clamp_max(LARGEST_ERROR)
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


def _alike(saved: Any, wanted: Tensor) -> bool:
    """Tell whether what was saved is a tensor like the one that is wanted, the same if that is a
    number, and finite.
    """
    if not isinstance(saved, Tensor) or (saved.shape, saved.dtype) != (wanted.shape, wanted.dtype):
        return False
    return bool(saved.isfinite().all() and wanted.isfinite().all()) and (
        wanted.dim() > 0 or saved.equal(wanted)
    )


class RenderedImages(IterableDataset):
    """What an eye is shown in the updates from ``first`` on: images ``(F, H, W, 6)`` uint8 and
    places ``(F, 3)`` [m].

    Several workers take turns. Each begins a new stream of random numbers after every save.
    """

    def __init__(self, recipe: PretrainRecipe, first: int) -> None:
        self._recipe, self._first = recipe, first

    def __iter__(self) -> Iterator[tuple[Any, Any]]:
        """Yield those of this worker."""
        info, every = get_worker_info(), self._recipe.save_every
        turn, n_workers = (0, 1) if info is None else (info.id, info.num_workers)
        stream = ImageStream(self._recipe, (self._first + turn) % n_workers, n_workers)
        for save, updates in groupby(
            range(self._first + turn, self._recipe.updates, n_workers), lambda i: i // every
        ):
            for _, shown in zip(updates, stream(save * every), strict=False):
                yield shown.images, shown.place


class RunFolder:
    """Keeps log and saved state together: what was logged after the last save is dropped when a run
    resumes from it.
    """

    def __init__(self, path: Path, task: dict[str, Any]) -> None:
        """Claim a folder for ``task`` as long as this object lives; raises what ``working_folder``
        raises.
        """
        self.path = path
        claim = ExitStack()
        claim.enter_context(working_folder(path, task))
        self.release = weakref.finalize(self, claim.close)

    def log(self, line: dict[str, Any]) -> None:
        """Append a line of JSON."""
        with (self.path / LOG).open("a") as file:
            file.write(json.dumps(line) + "\n")

    def save(self, state: dict[str, Any]) -> None:
        """Write what to go on from, whole or not at all, in place of what was saved before."""
        whole = state | {"log": read_text(self.path / LOG)}
        write_atomically({self.path / STATE: lambda path: torch.save(whole, path)})

    def restore(self) -> dict[str, Any] | None:
        """Return what was saved last, on the CPU, None for nothing, and let the log end there."""
        if not (self.path / STATE).exists():
            (self.path / LOG).unlink(missing_ok=True)
            return None
        with reading(self.path / STATE):
            state = torch.load(regular(self.path / STATE), weights_only=True, map_location="cpu")
            log = str(state["log"])
        write_atomically(
            {self.path / LOG: lambda path: path.write_text(log)}
        )  # in place of a pipe or a link, too
        return state


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
        except (
            Exception
        ) as error:  # whatever options and devices that do not exist make torch raise
            raise ValueError(
                f"eye is {recipe.eye} on {recipe.device!r}, which cannot be made: {error}"
            ) from error
        pose, (focal_px, _, centre_px, _) = calibration(recipe)
        carried = recipe.camera == EGO_VIEW
        self._camera = Pinhole.from_pose(pose.tolist(), centre_px / focal_px, carried=carried).to(
            recipe.device
        )
        self.optimizer = torch.optim.AdamW(eye.parameters(), lr=0.0, weight_decay=1e-4)
        self.n_updates, self._spent_s = 0, 0.0
        self._folder = RunFolder(recipe.out, draccus.encode(replace(recipe, out=Path())))
        with reading(recipe.out / STATE):
            if state := self._folder.restore():
                for name, kind in STATE_TYPES.items():
                    if not isinstance(state.get(name), kind):
                        raise TypeError(f"it has no {name!r} of type {kind.__name__}")
                self.n_updates, self._spent_s = state["updates"], state["processor_s"]
                if not 1 <= self.n_updates <= recipe.updates or not 0 <= self._spent_s < math.inf:
                    told = f"{self.n_updates} updates in {self._spent_s} s"
                    raise ValueError(
                        f"it says {told}; it must be 1 to {recipe.updates}, in 0 s or more"
                    )
                self._eye.load_state_dict(state["weights"])
                moments = state["optimizer"]["state"]
                for place, weight in enumerate(self._eye.parameters()):
                    wanted = {
                        "step": torch.tensor(float(self.n_updates)),
                        "exp_avg": weight,
                        "exp_avg_sq": weight,
                    }
                    held = moments.get(place, {})
                    if wrong := [
                        name for name in wanted if not _alike(held.get(name), wanted[name])
                    ]:
                        raise ValueError(
                            f"weight {place} or its {wrong[0]} is not that of {self.n_updates} "
                            f"updates"
                        )
                groups = self.optimizer.state_dict()[
                    "param_groups"
                ]  # the recipe's, whatever the file says
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
        recipe, losses = self.recipe, []
        shown = RenderedImages(recipe, self.n_updates)
        context = (
            "spawn" if recipe.workers else None
        )  # a process that is forked from one that uses CUDA cannot
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
        rate = min(1.0, (self.n_updates + 1) / WARMUP_UPDATES) * (
            0.02 + 0.49 * (1 + math.cos(math.pi * progress))
        )
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
