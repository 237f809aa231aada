"""Attention pooling: many tokens to one vector by a learned query (Lee et al., 2019, Set Transformer)."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class AttentionPooling(nn.Module):
    """One query attends to all tokens, then a gated feed-forward layer (Shazeer, 2020).

    Args:
        width: size of the tokens.
        n_heads: attention heads.
        expansion: size of the hidden layer over ``width``.
    """

    def __init__(self, width: int, n_heads: int, expansion: int = 4) -> None:
        super().__init__()
        self.query = nn.Parameter(0.02 * torch.randn(1, 1, width))
        self.attention = nn.MultiheadAttention(width, n_heads, batch_first=True)
        self.attention_norm, self.mlp_norm = nn.RMSNorm(width), nn.RMSNorm(width)
        self.gated, self.out = nn.Linear(width, 2 * expansion * width), nn.Linear(expansion * width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        """Map tokens ``(B, N, width)`` to a vector ``(B, width)``."""
        query = self.query.expand(len(tokens), -1, -1)
        pooled = self.attention_norm(query + self.attention(query, tokens, tokens, need_weights=False)[0])
        return self.mlp_norm(pooled + self.out(nn.functional.glu(self.gated(pooled))))[:, 0]
