"""Discretises actions in [-1, 1] into tokens, the last 256 ids of the vocabulary (OpenVLA, Section 3.2)."""

import torch
from torch import Tensor

N_BINS = 256


def encode(values: Tensor, vocabulary: int) -> Tensor:
    """Return the token id of each value; values outside [-1, 1] are clipped.

    Args:
        values: normalised actions, any shape.
        vocabulary: number of tokens of the tokenizer; the ids count down from it.
    """
    return vocabulary - torch.bucketize(values.float().clamp(-1, 1), _edges(values.device), right=True)


def decode(ids: Tensor, vocabulary: int) -> Tensor:
    """Return the centre of the bin of each id, in [-1, 1].

    Args:
        ids: token ids, any shape.
        vocabulary: number of tokens of the tokenizer.
    """
    edges = _edges(ids.device)
    centres = (edges[:-1] + edges[1:]) / 2
    return centres[(vocabulary - ids - 1).clamp(0, N_BINS - 2)]


def token_ids(vocabulary: int) -> range:
    """Return the ids of the action tokens, given the number of tokens of the tokenizer."""
    return range(vocabulary - N_BINS, vocabulary)


def _edges(device: torch.device) -> Tensor:
    return torch.linspace(-1, 1, N_BINS, device=device)
