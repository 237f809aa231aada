"""Training an eye: each picture is seen once, so there is nothing to overfit to."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING

import torch
from safetensors.torch import save_file

from .backbones import backbones
from .backbones.eye import EyeBackbone, sighting_loss
from .updates import learning_rate, take_step

if TYPE_CHECKING:
    from dynahoi_lerobot.onpolicy.recipe import EyeRecipe
    from dynahoi_lerobot.onpolicy.snapshots import Snapshots

WARMUP_UPDATES = 200
LOG_EVERY = 100
WEIGHTS, LOG = "eye.safetensors", "log.jsonl"
GRADIENT_CLIP = 5.0


def train_eye(recipe: EyeRecipe, stream: Iterator[Snapshots]) -> Iterator[str]:
    """Train the eye of a recipe's policy on a stream of pictures; write its weights into ``recipe.out``.

    Yields:
        A line of the log, JSON, now and then.

    Raises:
        FloatingPointError: if the loss is not finite.
    """
    torch.manual_seed(recipe.seed)
    options = recipe.policy.get("backbone_options", {}) | {"frozen": False}
    eye: EyeBackbone = backbones.build("eye", recipe.policy.get("width", 128), options=options)
    eye.load_pretrained()
    optimizer = torch.optim.AdamW(eye.parameters(), lr=0.0, weight_decay=1e-4)
    n_updates, recent = recipe.pictures // recipe.batch_size, []
    recipe.out.mkdir(parents=True, exist_ok=True)
    with (recipe.out / LOG).open("w") as log:
        for step, shown in enumerate(islice(stream, n_updates)):
            rate = learning_rate(recipe.learning_rate, step, n_updates, WARMUP_UPDATES)
            images = torch.from_numpy(shown.images).permute(0, 3, 1, 2) / 255.0  # (F, 6, H, W)
            loss = sighting_loss(eye, images, torch.from_numpy(shown.offset)).mean()
            recent.append(take_step(optimizer, loss, eye.parameters(), max_norm=GRADIENT_CLIP, rate=rate, n=step))
            if (step + 1) % LOG_EVERY == 0 or step + 1 == n_updates:
                minutes = round(time.process_time() / 60, 3)
                line = {"pictures": (step + 1) * recipe.batch_size, "processor_minutes": minutes}
                told = json.dumps({**line, "loss": round(sum(recent) / len(recent), 4)})
                log.write(told + "\n")
                recent.clear()
                yield told
    save_file(eye.learned_state(), recipe.out / WEIGHTS)
