"""The frames that a LeRobot policy remembers, when not every frame asks it for an action.

``select_action`` notes every frame and decides by itself when to predict a chunk; ``predict_action_chunk`` predicts at
once, and what it does about earlier frames differs from policy to policy.
"""

from __future__ import annotations

from typing import Any


def note_frame(policy: Any, batch: dict[str, Any]) -> None:
    """Note a preprocessed frame of all worlds in which no chunk is asked for; a policy without history ignores it."""
    if hasattr(policy, "observe"):
        policy.observe(batch)
    else:
        queued_frame(policy, batch)


def queued_frame(policy: Any, batch: dict[str, Any]) -> dict[str, Any]:
    """Add a frame to the observation queues of a policy that has them (Diffusion Policy, VQ-BeT, multi-task DiT).

    Returns:
        What ``predict_action_chunk`` of such a policy takes: the batch, with its images stacked under one key.
    """
    import torch
    from lerobot.policies.utils import populate_queues
    from lerobot.utils.constants import ACTION, OBS_IMAGES

    queues = getattr(policy, "_queues", None) or {}
    if OBS_IMAGES in queues:
        images = [batch[key] for key in policy.config.image_features]
        batch = batch | {OBS_IMAGES: torch.stack(images, dim=-4)}
    if queues:  # a policy looks into the queue of every key of the batch, and that of actions may be empty
        batch = {key: value for key, value in batch.items() if key != ACTION}
    populate_queues(queues, batch)
    return batch
