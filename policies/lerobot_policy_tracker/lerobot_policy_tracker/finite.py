"""Stops training at the first loss that is not finite, and says where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor


def require_finite(losses: Mapping[str, Tensor], batch: Mapping[str, Any]) -> None:
    """Check every part of a loss.

    Args:
        losses: parts of the loss by name, any shape.
        batch: the preprocessed LeRobot batch that they were computed from.

    Raises:
        FloatingPointError: if a part is not finite, naming the part, the dataset frames of the batch where it has their
            ``index``, and the inputs that are not finite themselves.
    """
    # One synchronisation with the device for all parts: the rest is only computed once training has failed.
    if torch.stack([loss.isfinite().all() for loss in losses.values()]).all():
        return
    parts = " and ".join(name for name, loss in losses.items() if not loss.isfinite().all())
    broken = [key for key, value in batch.items() if _has_broken_number(value)]
    cause = f"{', '.join(broken)} of the batch is not finite" if broken else "every input of the batch is finite"
    raise FloatingPointError(
        f"the {parts} loss is not finite: {cause}{_frames(batch)}; "
        "check these frames and the dataset's statistics, or lower optimizer_lr."
    )


def _has_broken_number(value: Any) -> bool:
    return isinstance(value, Tensor) and value.is_floating_point() and not bool(value.isfinite().all())


def _frames(batch: Mapping[str, Any]) -> str:
    index = batch.get("index")
    return f" (dataset frames {', '.join(map(str, index.flatten().tolist()))})" if isinstance(index, Tensor) else ""
