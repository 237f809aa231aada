"""What the language model reads: an instruction, an image's codes, and a place for each action."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Vocabulary:
    """Ids of the language model's words, then of four marks, then of the image's codes.

    Attributes:
        n_words: Rows of the language model's own embeddings.
        n_codes: Different codes of an image.
    """

    n_words: int
    n_codes: int

    @property
    def start_of_task(self) -> int:
        """Before the instruction."""
        return self.n_words

    @property
    def start_of_image(self) -> int:
        """Before the codes."""
        return self.n_words + 1

    @property
    def end_of_image(self) -> int:
        """After the codes."""
        return self.n_words + 2

    @property
    def act(self) -> int:
        """Where an action is thought of."""
        return self.n_words + 3

    @property
    def first_code(self) -> int:
        """Code 0."""
        return self.n_words + 4

    def __len__(self) -> int:
        return self.n_words + 4 + self.n_codes


@dataclass(frozen=True)
class Sequence:
    """Inputs of the language model.

    Attributes:
        ids: (B, L) int64.
        mask: (B, 1, L, L) bool, whether the second to last index may see the last.
        positions: (B, L) int64, counted without padding.
        codes: where the codes are.
        actions: where the actions are.
    """

    ids: Tensor
    mask: Tensor
    positions: Tensor
    codes: slice
    actions: slice


def lay_out(words: Tensor, kept: Tensor, codes: Tensor, n_actions: int, vocabulary: Vocabulary) -> Sequence:
    """Return [task, words, image, codes, image end, actions] (UP-VLA, Section 3).

    Words and actions see what is before them. The image, of which every code becomes the code that will be there,
    sees the whole sequence.

    Args:
        words: (B, W) int64, padded on the left.
        kept: (B, W), 0 where there is padding.
        codes: (B, N) int64, of the image.
        n_actions: Number of places for actions.
        vocabulary: Which id means what.
    """
    n, (width, n_codes) = len(words), (words.shape[1], codes.shape[1])
    mark = torch.ones_like(words[:, :1])
    parts = [
        vocabulary.start_of_task * mark,
        words,
        vocabulary.start_of_image * mark,
        codes + vocabulary.first_code,
        vocabulary.end_of_image * mark,
        vocabulary.act * mark.expand(n, n_actions),
    ]
    ids = torch.cat(parts, dim=1)  # (B, L)
    length, image = ids.shape[1], slice(width + 1, width + n_codes + 3)
    real = torch.ones_like(ids, dtype=torch.bool)
    real[:, 1 : width + 1] = kept.bool()
    mask = torch.ones(length, length, dtype=torch.bool, device=ids.device).tril()
    mask[image] = True
    mask = mask & real.unsqueeze(1) | torch.eye(length, dtype=torch.bool, device=ids.device)
    return Sequence(
        ids=ids,
        mask=mask.unsqueeze(1),
        positions=real.cumsum(1) - 1,
        codes=slice(image.start + 1, image.stop - 1),
        actions=slice(length - n_actions, length),
    )
