"""A small byte-level text encoder, for backbones without text input; it needs no tokenizer."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

N_SYMBOLS = 257  # 256 byte values, shifted by one to leave 0 for padding


def encode_bytes(texts: list[str], max_bytes: int) -> Tensor:
    """Return UTF-8 bytes + 1, truncated to ``max_bytes`` and zero-padded to the longest text, int64 ``(B, L)``."""
    rows = [torch.tensor([byte + 1 for byte in text.encode()[:max_bytes]] or [0]) for text in texts]
    return nn.utils.rnn.pad_sequence(rows, batch_first=True)


class ByteTextEncoder(nn.Module):
    """Two convolutions over byte embeddings and a masked mean, so that padding changes nothing.

    Args:
        width: size of the text token.
        max_bytes: length at which instructions are truncated [bytes].
    """

    def __init__(self, width: int, max_bytes: int = 160) -> None:
        super().__init__()
        self.max_bytes = max_bytes
        self.embedding = nn.Embedding(N_SYMBOLS, width // 2, padding_idx=0)
        self.conv1 = nn.Conv1d(width // 2, width // 2, kernel_size=5, padding=2)
        self.conv2 = nn.Conv1d(width // 2, width, kernel_size=5, padding=2)
        self.norm = nn.LayerNorm(width)

    def forward(self, texts: list[str]) -> Tensor:
        """Encode instructions, ``B`` strings -> one token each, shape ``(B, 1, D)``."""
        unique = sorted(set(texts))  # a batch repeats few instructions
        row = {text: i for i, text in enumerate(unique)}
        tokens = self._encode(encode_bytes(unique, self.max_bytes).to(self.embedding.weight.device))
        return tokens[[row[text] for text in texts]][:, None]  # (U, D) -> (B, 1, D)

    def _encode(self, symbols: Tensor) -> Tensor:
        keep = (symbols > 0)[:, None].float()  # (U, 1, L)
        x = self.embedding(symbols).transpose(1, 2)  # (U, L, D/2) -> (U, D/2, L)
        x = F.gelu(self.conv1(x)) * keep  # zeros beyond the end, as if the sequence stopped there
        x = F.gelu(self.conv2(x)) * keep  # (U, D, L)
        return self.norm(x.sum(-1) / keep.sum(-1).clamp_min(1))  # (U, D)
