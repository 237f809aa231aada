"""Spatiotemporal attention: fuses the observed frames into the current one.

The paper (Section 4, the tracker) fuses ``s`` observed frames with the current frame by spatiotemporal attention
and gives no equations; these are ours. With current tokens ``x`` (M of them) and frame tokens ``f_t``:

    z_m = Attention(q = x_m, kv = {f_tm + phi(t)} over t)     over time, each token by itself
    y   = z + Attention(q = z, kv = z)                        over the tokens of the current frame
    x  <- x + tanh(g) y,   g = 0 at the start

``phi`` embeds the age of a frame in seconds, so that one set of weights serves any frame rate and stride. The
gate makes the untrained block the identity: a policy with history starts as exactly the single-frame policy. The
factorised attention costs M T + M^2 instead of (M T)^2. Keys and values of a frame do not depend on the decision that
attends to it, so decisions that share a frame share them.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .decisions import Decisions

# Adam moves a parameter by about one learning rate a step, whatever its gradient. A gate that starts at zero
# would need thousands of steps to open; this factor makes it hundreds.
GATE_GAIN = 10.0


def sinusoidal_features(x: Tensor, n_features: int, min_period: float, max_period: float) -> Tensor:
    """Embed a real number as sines and cosines with geometrically spaced periods.

    Args:
        x: any shape ``(...)``.
        n_features: even number of features.
        min_period: shortest period, in the unit of ``x``.
        max_period: longest period, in the unit of ``x``.

    Returns:
        Shape ``(..., n_features)``, in [-1, 1].
    """
    fraction = torch.linspace(0, 1, n_features // 2, device=x.device, dtype=torch.float32)
    period = min_period * (max_period / min_period) ** fraction
    angle = 2 * math.pi * x.float()[..., None] / period
    return torch.cat([angle.sin(), angle.cos()], dim=-1)


class Attention(nn.Module):
    """Multi-head attention of queries over a memory, ``softmax(q k^T / sqrt(d)) v``.

    Args:
        width: token size of queries, memory and output.
        n_heads: heads; must divide ``width``.
        dropout: dropout probability on the attention weights.
    """

    def __init__(self, width: int, n_heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.n_heads, self.dropout = n_heads, dropout
        self.q_proj = nn.Linear(width, width)
        self.k_proj = nn.Linear(width, width)
        self.v_proj = nn.Linear(width, width)
        self.o_proj = nn.Linear(width, width)

    def forward(self, x: Tensor, memory: Tensor) -> Tensor:
        """Attend from queries ``(B, Q, D)`` to a memory ``(B, K, D)``; returns ``(B, Q, D)``."""
        q, k, v = self._split(self.q_proj(x)), self._split(self.k_proj(memory)), self._split(self.v_proj(memory))
        out = F.scaled_dot_product_attention(q, k, v, dropout_p=self.dropout if self.training else 0.0)
        return self.o_proj(out.transpose(1, 2).flatten(2))  # (B, heads, Q, d) -> (B, Q, D)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.n_heads, -1)).transpose(-3, -2)  # (..., N, D) -> (..., heads, N, d)


class TemporalAttention(Attention):
    """Attention of each current token to the tokens at the same place in earlier frames.

    The windows of neighbouring decisions overlap. The scores of all decisions with all frames of the sample are
    therefore computed at once, in small dense products, and each decision gathers those of its window; copying the keys
    and values of every window would move ``W`` times as much memory. The embedding of a frame's age is the same for
    every frame of that age, so its scores are computed once per age.
    """

    def forward(self, x: Tensor, frames: Tensor, decisions: Decisions, age: tuple[Tensor, Tensor]) -> Tensor:
        """Attend to a window of frames per decision.

        Args:
            x: queries of the wanted decisions, shape ``(R, N, D)``.
            frames: tokens of every frame, shape ``(B, T, N, D)``.
            decisions: window and padding mask of each decision.
            age: embedding of each age in the window, added to keys and to values, ``(W, D)`` each.

        Returns:
            Shape ``(R, N, D)``.
        """
        q = self._tracks(decisions.spread(self.q_proj(x)))  # (B, N, heads, K, d)
        k, v = self._tracks(self.k_proj(frames)), self._tracks(self.v_proj(frames))  # (B, N, heads, T, d)
        age_k, age_v = (self._split(part) for part in age)  # (heads, W, d)
        frame_scores = q @ k.transpose(-1, -2)  # (B, N, heads, K, T)
        age_scores = q @ age_k.transpose(-1, -2)  # (B, N, heads, K, W)
        index = decisions.frame_index.expand(age_scores.shape)
        scores = (frame_scores.gather(-1, index) + age_scores) * q.shape[-1] ** -0.5
        scores = scores.masked_fill(~decisions.keep[:, None, None], float("-inf"))  # (B, 1, 1, K, W)
        weights = F.dropout(scores.softmax(-1), self.dropout, self.training).to(v.dtype)
        context = (
            torch.zeros_like(frame_scores).scatter_add(-1, index, weights) @ v + weights @ age_v
        )  # (B, N, heads, K, d)
        return self.o_proj(decisions.pick(context.permute(0, 3, 1, 2, 4)).flatten(2))  # (R, N, heads, d) -> (R, N, D)

    def _tracks(self, x: Tensor) -> Tensor:
        """Group tokens by place and head, their times last but one, ``(B, T, N, D) -> (B, N, heads, T, d)``."""
        return x.unflatten(-1, (self.n_heads, -1)).permute(0, 2, 3, 1, 4)


def feed_forward(width: int, dropout: float = 0.0, expansion: int = 2) -> nn.Sequential:
    """Return the two-layer network that follows every attention, ``(..., D) -> (..., D)``."""
    hidden = expansion * width
    return nn.Sequential(nn.Linear(width, hidden), nn.GELU(), nn.Dropout(dropout), nn.Linear(hidden, width))


class AgeEmbedding(nn.Module):
    """Embeds the age of a frame as vectors that are added to its keys and values.

    Args:
        width: token size.
        min_period_s: shortest resolved period [s].
        max_period_s: longest resolved period [s].
    """

    def __init__(self, width: int, min_period_s: float = 0.1, max_period_s: float = 20.0) -> None:
        super().__init__()
        self.width, self.min_period_s, self.max_period_s = width, min_period_s, max_period_s
        self.mlp = nn.Sequential(nn.Linear(width + 1, width), nn.SiLU(), nn.Linear(width, 2 * width))

    def forward(self, age_s: Tensor) -> tuple[Tensor, Tensor]:
        """Map ages [s], shape ``(W,)``, to a key part and a value part, each ``(W, D)``."""
        features = sinusoidal_features(age_s, self.width, self.min_period_s, self.max_period_s)
        key, value = self.mlp(torch.cat([age_s[:, None].float(), features], dim=-1)).chunk(2, dim=-1)
        return key, value


class SpatioTemporalBlock(nn.Module):
    """Temporal attention, spatial attention and a feed-forward network, see the equations of the module.

    Args:
        width: token size.
        n_heads: attention heads.
        dropout: dropout probability.
    """

    def __init__(self, width: int, n_heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.norm_query = nn.LayerNorm(width)
        self.norm_frames = nn.LayerNorm(width)
        self.age = AgeEmbedding(width)
        self.time = TemporalAttention(width, n_heads, dropout)
        self.norm_read = nn.LayerNorm(width)
        self.space = Attention(width, n_heads, dropout)
        self.gate = nn.Parameter(torch.zeros(width))
        self.norm_ff = nn.LayerNorm(width)
        self.ff = feed_forward(width, dropout)

    def forward(self, x: Tensor, frames: Tensor, decisions: Decisions) -> Tensor:
        """Update the current tokens of each wanted decision from its window.

        Args:
            x: current tokens, shape ``(R, N, D)``.
            frames: tokens of every frame, shape ``(B, T, N, D)``.
            decisions: window and padding mask of each decision.

        Returns:
            Current tokens, shape ``(R, N, D)``.
        """
        z = self.time(self.norm_query(x), self.norm_frames(frames), decisions, self.age(decisions.age_s))
        h = self.norm_read(z)
        x = x + torch.tanh(GATE_GAIN * self.gate) * (z + self.space(h, h))
        return x + self.ff(self.norm_ff(x))


class SpatioTemporalAttention(nn.Module):
    """A stack of `SpatioTemporalBlock`, which updates the current tokens and leaves those of the frames unchanged.

    Args:
        width: token size.
        n_layers: number of blocks.
        n_heads: attention heads.
        dropout: dropout probability.
    """

    def __init__(self, width: int, n_layers: int, n_heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(SpatioTemporalBlock(width, n_heads, dropout) for _ in range(n_layers))
        self.norm = nn.LayerNorm(width)

    def forward(self, frames: Tensor, decisions: Decisions) -> Tensor:
        """Fuse the window of each wanted decision into its current frame.

        Args:
            frames: tokens of every frame, shape ``(B, T, N, D)``.
            decisions: window and padding mask of each decision.

        Returns:
            Fused tokens of each current frame, shape ``(R, N, D)``.
        """
        x = decisions.current(frames)
        for block in self.blocks:
            x = block(x, frames, decisions)
        return self.norm(x)
