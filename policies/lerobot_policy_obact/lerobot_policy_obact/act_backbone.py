"""What `dynahoi pretrain` trains of LeRobot's ACT: its ResNet, which learns where the target is.

ACT keeps the statistics of its backbone's batch normalisation frozen, so random weights are not normalised at all, and
little of the loss of its actions reaches them. Here the backbone is trained with batch normalisation in use, by what a
linear map of its last feature map says of the target's place. It is saved within a whole ACT checkpoint, from which
``lerobot-train`` starts with ``policy.pretrained_path``.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import cast

import draccus
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from torch import Tensor, nn
from torchvision.models import ResNet, get_model
from torchvision.models._utils import IntermediateLayerGetter

from dynahoi_lerobot.core.files import read_yaml
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.snapshots import ImageStream

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""By which LeRobot standardises images unless told otherwise."""
PLACE_M = 0.3
"""Unit of the predicted place."""
LARGEST_LOSS = 4.0
"""A target that is out of view teaches nothing."""


class Localiser(nn.Module):
    """ACT's backbone with batch normalisation, and a linear map to the target's place.

    Args:
        config: of the policy.
        size: side of the images [px].
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: ACTConfig, size: int) -> None:
        super().__init__()
        resnet = cast(ResNet, get_model(config.vision_backbone, weights=config.pretrained_backbone_weights))
        self.backbone = IntermediateLayerGetter(resnet, return_layers={"layer4": "feature_map"})
        self.place = nn.Linear(resnet.fc.in_features * ceil(size / 32) ** 2, 3)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(-1, 1, 1))
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(-1, 1, 1))

    def forward(self, images: Tensor) -> Tensor:
        """Return where the target is, ``(F, 3)`` [m]; images are ``(F, 3, H, W)`` in [0, 1]."""
        cells = self.backbone((images - self.mean) / self.std)["feature_map"]
        return PLACE_M * self.place(cells.flatten(1))


class BackboneLearner:
    """ACT's backbone and its loss, see `lerobot_policy_obact.pretraining.Learner`.

    Args:
        recipe: which names the training recipe of the policy.
        images: unused; the target's place is relative to the palm.

    Raises:
        ValueError: if that recipe does not train an ACT whose features it names.
    """

    def __init__(self, recipe: PretrainRecipe, images: ImageStream) -> None:
        assert recipe.policy is not None
        self._config = act_config(recipe.policy)
        self.module = Localiser(self._config, recipe.episodes.image_size)

    def loss(self, images: Tensor, place: Tensor) -> Tensor:
        """Return the error of the place, ``(F,)``, in units that grow with the distance."""
        error = (self.module(images[:, :3]) - place).norm(dim=-1)
        return (error / (0.05 + 0.3 * place.norm(dim=-1))).clamp_max(LARGEST_LOSS)

    def save(self, folder: Path) -> None:
        """Write an ACT checkpoint with this backbone; its other weights are random."""
        policy = ACTPolicy(self._config)
        weights = self.module.backbone.state_dict()  # ACT's frozen normalisation counts no batches
        policy.model.backbone.load_state_dict(
            {k: v for k, v in weights.items() if not k.endswith("num_batches_tracked")}
        )
        policy.save_pretrained(folder)
        for processor in make_pre_post_processors(self._config):
            processor.save_pretrained(folder)


def act_config(path: Path) -> ACTConfig:
    """Return the ACT of a training recipe.

    Raises:
        ValueError: if there is none, or its features are not named.
    """
    values = read_yaml(path)
    try:
        config = draccus.decode(PreTrainedConfig, values.get("policy") if isinstance(values, dict) else None)
    except (draccus.utils.DraccusException, TypeError) as error:
        raise ValueError(f"{path} trains no policy: {error.__cause__ or error}") from error
    if not isinstance(config, ACTConfig):
        raise ValueError(f"policy must be a recipe that trains an act, but {path} trains a {config.type}")
    if not config.input_features or not config.output_features:
        raise ValueError(f"{path} must name the policy's input_features and output_features")
    return replace(config, pretrained_path=None)
