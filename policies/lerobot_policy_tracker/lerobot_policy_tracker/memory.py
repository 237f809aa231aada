"""What fuses the frames that a decision sees into its current frame: attention, or a recurrent network."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .attention import SpatioTemporalAttention, feed_forward
from .configuration_tracker import TrackerConfig
from .decisions import Decisions


def build_memory(config: TrackerConfig) -> nn.Module:
    """Return the module that ``config.memory_module`` names; it maps frames ``(B, T, N, D)`` to ``(R, N, D)``."""
    width, n_layers = config.width, config.n_attention_layers
    if config.memory_module == "gru":
        return RecurrentMemory(width, n_layers)
    return SpatioTemporalAttention(width, n_layers, config.n_attention_heads, config.dropout)


class RecurrentMemory(nn.Module):
    """A GRU over all frames in turn, for comparison with attention: it remembers what it chooses to.

    Args:
        width: token size.
        n_layers: layers of the GRU.
    """

    def __init__(self, width: int, n_layers: int) -> None:
        super().__init__()
        self.gru = nn.GRU(width, width, n_layers, batch_first=True)
        self.norm_ff = nn.LayerNorm(width)
        self.ff = feed_forward(width)
        self.norm = nn.LayerNorm(width)

    def forward(self, frames: Tensor, decisions: Decisions) -> Tensor:
        """Add the state after each decision's frame to its tokens; frames ``(B, T, N, D)``, returns ``(R, N, D)``."""
        x = decisions.current(frames)
        x = x + decisions.current(self._states(frames.mean(2), decisions.exists))[:, None]
        return self.norm(x + self.ff(self.norm_ff(x)))

    def _states(self, frames: Tensor, exists: Tensor) -> Tensor:
        """Return the state after each frame ``(B, T, D)``; what pads a sequence in front is put behind it instead."""
        n_padding = (~exists).long().cumprod(1).sum(1, keepdim=True)  # (B, 1)
        place = torch.arange(frames.shape[1], device=frames.device)
        states, _ = self.gru(_taken(frames, (place + n_padding) % len(place)))
        return _taken(states, (place - n_padding) % len(place))


def _taken(x: Tensor, index: Tensor) -> Tensor:
    """Return entries ``index`` (B, T) along the second axis of ``(B, T, D)``."""
    return x.gather(1, index[..., None].expand_as(x))
