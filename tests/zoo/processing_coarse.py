"""A tokenizer of actions with the interface of FAST: cosine transform, rounding, one token per
coefficient.
"""

from typing import Any

import numpy as np
from scipy.fft import dct
from transformers import ProcessorMixin

LEVELS = 64


class _Characters:
    """Stands in for FAST's byte-pair encoding: token k is the character of number k."""

    def decode(self, tokens: Any) -> str:
        return "".join(chr(max(int(token), 0)) for token in tokens)


class CoarseProcessor(ProcessorMixin):
    """Turns (B, H, A) actions into lists of tokens 0 to ``LEVELS`` - 1."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__()
        self.scale = 4
        self.min_token = -LEVELS // 2
        self.bpe_tokenizer = _Characters()

    def __call__(self, actions: Any) -> list[list[int]]:
        coefficients = dct(np.asarray(actions), axis=1, norm="ortho")  # (B, H, A)
        tokens = np.clip(
            np.round(coefficients * self.scale) - self.min_token, 0, LEVELS - 1
        ).astype(int)
        return [chunk.reshape(-1).tolist() for chunk in tokens]
