"""A diffusion transformer (Peebles and Xie, 2023) over a chunk of actions, shared by the flow and diffusion
heads.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..attention import Attention, feed_forward, sinusoidal_features
from .base import ActionSpec, Condition


class DiTBlock(nn.Module):
    """Self-attention over the chunk, cross-attention to the condition, feed-forward.

    Time enters through adaptive layer norm: ``c`` gives a scale, a shift and a gate for the self-attention
    and for the feed-forward network. The gates start at zero (AdaLN-Zero), so that an untrained block only
    cross-attends to the condition.

    Args:
        width: token size.
        n_heads: attention heads.
        dropout: dropout probability.
    """

    def __init__(self, width: int, n_heads: int, dropout: float) -> None:
        super().__init__()
        self.norm_self = nn.LayerNorm(width, elementwise_affine=False)
        self.self_attention = Attention(width, n_heads, dropout)
        self.norm_cross = nn.LayerNorm(width)
        self.cross_attention = Attention(width, n_heads, dropout)
        self.norm_ff = nn.LayerNorm(width, elementwise_affine=False)
        self.ff = feed_forward(width, dropout, expansion=4)
        self.modulation = nn.Linear(width, 6 * width)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(self, x: Tensor, c: Tensor, memory: Tensor) -> Tensor:
        """Refine action tokens ``(B, H, D)``, given the time vector ``(B, D)`` and condition tokens ``(B, N,
        D)``.
        """
        scale1, shift1, gate1, scale2, shift2, gate2 = self.modulation(c)[:, None].chunk(6, dim=-1)  # (B, 1, D) each
        h = self.norm_self(x) * (1 + scale1) + shift1
        x = x + gate1 * self.self_attention(h, h)
        x = x + self.cross_attention(self.norm_cross(x), memory)
        h = self.norm_ff(x) * (1 + scale2) + shift2
        return x + gate2 * self.ff(h)


class DiT(nn.Module):
    """Maps a noisy chunk, its flow time and a condition to a chunk-shaped prediction.

    Args:
        spec: sizes of the head and of its inputs.
        n_layers: number of blocks.
    """

    def __init__(self, spec: ActionSpec, n_layers: int) -> None:
        super().__init__()
        width = spec.width
        self.action_in = nn.Linear(spec.action_dim, width)
        self.position = nn.Parameter(0.02 * torch.randn(spec.horizon, width))
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU())
        self.blocks = nn.ModuleList(DiTBlock(width, spec.n_heads, spec.dropout) for _ in range(n_layers))
        self.norm_out = nn.LayerNorm(width)
        self.action_out = nn.Linear(width, spec.action_dim)
        nn.init.zeros_(self.action_out.weight)  # the first prediction is the mean, not noise
        nn.init.zeros_(self.action_out.bias)

    def forward(self, x: Tensor, t: Tensor, condition: Condition) -> Tensor:
        """Predict ``(B, H, A)`` from a noisy chunk ``(B, H, A)`` at times ``(B,)`` in [0, 1]."""
        c = self.time(sinusoidal_features(t, self.position.shape[-1], 0.01, 4.0).to(x.dtype))  # (B, D)
        x = self.action_in(x) + self.position  # (B, H, D)
        for block in self.blocks:
            x = block(x, c, condition.tokens)
        return self.action_out(self.norm_out(x))
