"""What fuses the frames that a decision sees into its current frame: spatiotemporal attention, or a recurrent network."""

from __future__ import annotations

from torch import Tensor, nn

from .attention import SpatioTemporalAttention, feed_forward
from .configuration_obact import ObActConfig
from .decisions import Decisions


def build_memory(config: ObActConfig) -> nn.Module:
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
        states, _ = self.gru(frames.mean(2))  # (B, T, D)
        x = decisions.current(frames) + decisions.current(states)[:, None]
        return self.norm(x + self.ff(self.norm_ff(x)))
