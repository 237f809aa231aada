"""Spatiotemporal attention: what the observed frames add to the current one.

The paper (Section 4, ObAct) fuses ``s`` observed frames with the current frame by spatiotemporal attention
and gives no equations; these are ours. With current tokens ``x`` (M of them) and frame tokens ``f_t``:

    y_t = Attention(q = x, kv = f_t)                      space: each query reads every frame on its own
    z   = Attention(q = x, kv = {y_t + phi(t)})           time: and then weighs what it read over the frames
    x  <- x + tanh(g) z,   g = 0 at the start

``phi`` embeds the age of a frame in seconds, so that one set of weights serves any frame rate and stride. The
gate makes the untrained block the identity: a policy with history starts as exactly the one without, and what
history adds is learned on top. Space before time costs M^2 T + M T instead of (M T)^2.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

# Adam moves a parameter by about one learning rate a step, whatever its gradient. A gate that starts at zero
# would need thousands of steps to open; this factor makes it hundreds.
GATE_GAIN = 10.0


def sinusoidal_features(x: Tensor, n_features: int, min_period: float, max_period: float) -> Tensor:
    """Embed a real number as sines and cosines with geometrically spaced periods.

    Args:
        x: Any shape ``(...)``.
        n_features: Even number of features.
        min_period: Shortest period, in the unit of ``x``.
        max_period: Longest period, in the unit of ``x``.

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
        width: Token size of queries, memory and output.
        n_heads: Heads; must divide ``width``.
        dropout: Dropout probability on the attention weights.
    """

    def __init__(self, width: int, n_heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.n_heads, self.dropout = n_heads, dropout
        self.q_proj = nn.Linear(width, width)
        self.k_proj = nn.Linear(width, width)
        self.v_proj = nn.Linear(width, width)
        self.o_proj = nn.Linear(width, width)

    def forward(self, x: Tensor, memory: Tensor, keep: Tensor | None = None) -> Tensor:
        """Attend.

        Args:
            x: Queries, shape ``(B, Q, D)``.
            memory: Keys and values, shape ``(B * R, K, D)``: each row of queries reads ``R`` memories in a row,
                each on its own.
            keep: True where the memory may be read, shape ``(B * R, K)``; None reads all of it.

        Returns:
            Shape ``(B * R, Q, D)``.
        """
        q = self._split(self.q_proj(x)).repeat_interleave(len(memory) // len(x), dim=0)  # (B * R, heads, Q, d)
        k, v = self._split(self.k_proj(memory)), self._split(self.v_proj(memory))  # (B * R, heads, K, d)
        mask = None if keep is None else keep[:, None, None, :]  # (B * R, 1, 1, K)
        out = F.scaled_dot_product_attention(q, k, v, mask, dropout_p=self.dropout if self.training else 0.0)
        return self.o_proj(out.transpose(1, 2).flatten(2))  # (B * R, heads, Q, d) -> (B * R, Q, D)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.n_heads, -1)).transpose(1, 2)  # (B, N, D) -> (B, heads, N, d)


def feed_forward(width: int, dropout: float = 0.0, expansion: int = 2) -> nn.Sequential:
    """Return the two-layer network that follows every attention, ``(..., D) -> (..., D)``."""
    hidden = expansion * width
    return nn.Sequential(nn.Linear(width, hidden), nn.GELU(), nn.Dropout(dropout), nn.Linear(hidden, width))


class AgeEmbedding(nn.Module):
    """Embeds how long ago a frame was seen.

    Args:
        width: Token size.
        min_period_s: Shortest resolved period [s].
        max_period_s: Longest resolved period [s].
    """

    def __init__(self, width: int, min_period_s: float = 0.1, max_period_s: float = 20.0) -> None:
        super().__init__()
        self.width, self.min_period_s, self.max_period_s = width, min_period_s, max_period_s
        self.mlp = nn.Sequential(nn.Linear(width + 1, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, age_s: Tensor) -> Tensor:
        """Embed ages [s], shape ``(...)`` -> ``(..., D)``."""
        waves = sinusoidal_features(age_s, self.width, self.min_period_s, self.max_period_s)
        return self.mlp(torch.cat([age_s[..., None].float(), waves], dim=-1))


class SpatioTemporalBlock(nn.Module):
    """One block of the module's equations, then a feed-forward network on the current tokens.

    Args:
        width: Token size.
        n_heads: Attention heads.
        dropout: Dropout probability.
    """

    def __init__(self, width: int, n_heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.norm_query = nn.LayerNorm(width)
        self.norm_frames = nn.LayerNorm(width)
        self.space = Attention(width, n_heads, dropout)
        self.norm_read = nn.LayerNorm(width)
        self.age = AgeEmbedding(width)
        self.time = Attention(width, n_heads, dropout)
        self.gate = nn.Parameter(torch.zeros(width))
        self.norm_ff = nn.LayerNorm(width)
        self.ff = feed_forward(width, dropout)

    def forward(self, x: Tensor, frames: Tensor, age_s: Tensor, keep: Tensor) -> Tensor:
        """Let the current tokens read the frames.

        Args:
            x: Current tokens, shape ``(B, M, D)``.
            frames: Tokens of every visible frame, the current one included, shape ``(B, T, N, D)``.
            age_s: Time of each frame before the current one, 0 for the current one [s], shape ``(B, T)``.
            keep: False where a frame is padding, shape ``(B, T)``.

        Returns:
            Current tokens, shape ``(B, M, D)``.
        """
        x = x + torch.tanh(GATE_GAIN * self.gate) * self.read(self.norm_query(x), frames, age_s, keep)
        return x + self.ff(self.norm_ff(x))

    def read(self, q: Tensor, frames: Tensor, age_s: Tensor, keep: Tensor) -> Tensor:
        """Return what queries ``(B, M, D)`` gather over space and then time, shape ``(B, M, D)``."""
        n_batch, n_frames = frames.shape[:2]
        per_frame = self.norm_frames(frames).flatten(0, 1)  # (B, T, N, D) -> (B*T, N, D)
        seen = self.space(q, per_frame)  # (B*T, M, D)
        seen = self.norm_read(seen.unflatten(0, (n_batch, n_frames)))  # (B, T, M, D)
        seen = seen + self.age(age_s)[:, :, None]  # (B, T, M, D)

        n_queries = q.shape[1]
        tracks = seen.transpose(1, 2).flatten(0, 1)  # (B, T, M, D) -> (B*M, T, D)
        queries = q.flatten(0, 1)[:, None]  # (B, M, D) -> (B*M, 1, D)
        read = self.time(queries, tracks, keep.repeat_interleave(n_queries, dim=0))  # (B*M, 1, D)
        return read.reshape(n_batch, n_queries, -1)  # (B, M, D)


class SpatioTemporalAttention(nn.Module):
    """A stack of `SpatioTemporalBlock`: the observed frames stay as they are, the current tokens are refined.

    Args:
        width: Token size.
        n_layers: Number of blocks.
        n_heads: Attention heads.
        dropout: Dropout probability.
    """

    def __init__(self, width: int, n_layers: int, n_heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(SpatioTemporalBlock(width, n_heads, dropout) for _ in range(n_layers))
        self.norm = nn.LayerNorm(width)

    def forward(self, frames: Tensor, age_s: Tensor, keep: Tensor) -> Tensor:
        """Fuse a window into its last frame.

        Args:
            frames: Tokens of the window, the current frame last, shape ``(B, T, N, D)``.
            age_s: Time before the current frame [s], shape ``(B, T)``.
            keep: False where a frame is padding, shape ``(B, T)``.

        Returns:
            Tokens of the current frame, aware of the others, shape ``(B, N, D)``.
        """
        keep = torch.cat([keep[:, :-1], torch.ones_like(keep[:, -1:])], dim=1)  # a query always sees its own frame
        x = frames[:, -1]
        for block in self.blocks:
            x = block(x, frames, age_s, keep)
        return self.norm(x)
