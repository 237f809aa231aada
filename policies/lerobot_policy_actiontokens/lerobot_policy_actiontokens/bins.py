"""Numbers in [-1, 1] as tokens: 256 edges, and the last ids of the vocabulary (OpenVLA, Section 3.2)."""

from __future__ import annotations

import torch
from torch import Tensor

N_BINS = 256


def encode(values: Tensor, vocabulary: int) -> Tensor:
    """Return the token ids of ``values``, any shape; what lies outside [-1, 1] is clipped.

    Args:
        values: normalised actions.
        vocabulary: number of tokens of the tokenizer; the ids count down from it.
    """
    return vocabulary - torch.bucketize(values.float().clamp(-1, 1), _edges(values.device), right=True)


def decode(ids: Tensor, vocabulary: int) -> Tensor:
    """Return the middle of the bin of each id, in [-1, 1]."""
    edges = _edges(ids.device)
    middles = (edges[:-1] + edges[1:]) / 2
    return middles[(vocabulary - ids - 1).clamp(0, N_BINS - 2)]


def token_ids(vocabulary: int) -> range:
    """Return the ids that mean an action."""
    return range(vocabulary - N_BINS, vocabulary)


def _edges(device: torch.device) -> Tensor:
    return torch.linspace(-1, 1, N_BINS, device=device)
