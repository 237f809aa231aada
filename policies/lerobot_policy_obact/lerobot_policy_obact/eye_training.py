"""What `dynahoi pretrain` trains of ObAct: the eye, on images of random configurations."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor

from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.snapshots import ImageStream

from .camera import Pinhole
from .encoders import Eye
from .recordings import CARRIED_VIEW

WEIGHTS = "eye.safetensors"
HEAT_WEIGHT = 0.3


def sighting_loss(eye: Eye, camera: Pinhole, images: Tensor, place: Tensor) -> Tensor:
    """Return the loss of each image: attention, Laplace likelihood of direction and depth, and error in metres.

    Args:
        eye: whose loss it is.
        camera: whose images these are.
        images: RGB in [0, 1] with the images before, ``(F, 6, H, W)``.
        place: where the target is, relative to the camera's origin [m], world axes, ``(F, 3)``.
    """
    sighting, heat = eye.look(images)
    seen, scales = sighting[:, :3], sighting[:, 3:5]
    true = camera.seen(place)
    across = (seen[:, :2] - true[:, :2]).square().sum(-1).add(1e-8).sqrt()
    along = (seen[:, 2] - true[:, 2]).abs()
    error = torch.stack([across, along], dim=-1)  # (F, 2)
    likelihood = (error * (-scales).exp() + scales * scales.new_tensor([2.0, 1.0])).sum(-1)
    metric = (camera.place(seen) - place).norm(dim=-1) / (0.05 + 0.3 * place.norm(dim=-1))
    return HEAT_WEIGHT * _heat_loss(heat, true) + 0.1 * likelihood + across + along + metric.clamp_max(4.0)


def _heat_loss(heat: Tensor, true: Tensor) -> Tensor:
    """Return the cross-entropy of the cell that the target is in, 0 where it is out of view, ``(F,)``."""
    size = true.new_tensor([heat.shape[-1], heat.shape[-2]])
    place = ((true[:, :2] * true.new_tensor([1.0, -1.0]) + 1) / 2 * size).floor().long()
    cell = torch.minimum(place.clamp_min(0), size.long() - 1)
    return -heat[torch.arange(len(heat)), cell[:, 1], cell[:, 0]] * (place == cell).all(-1)


class EyeLearner:
    """An eye and its loss, see `lerobot_policy_obact.pretraining.Learner`.

    Args:
        recipe: the options of the eye, and its camera.
        images: what is shown.
    """

    def __init__(self, recipe: PretrainRecipe, images: ImageStream) -> None:
        self.module = Eye(**recipe.eye)
        self.module.load_pretrained()
        pose, (focal_px, _, centre_px, _) = images.camera
        self._camera = Pinhole.from_pose(pose.tolist(), centre_px / focal_px, carried=recipe.camera == CARRIED_VIEW)

    def loss(self, images: Tensor, place: Tensor) -> Tensor:
        """Return the loss of each image, see `sighting_loss`."""
        return sighting_loss(self.module, self._camera.to(place.device), images, place)

    def save(self, folder: Path) -> None:
        """Write the weights, for the option ``weights`` of `Eye`."""
        write_atomically({folder / WEIGHTS: lambda path: save_file(self.module.state_dict(), path)})
