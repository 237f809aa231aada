"""The input sequence of the language model: an instruction, the codes of an image, and a placeholder per action."""

import torch
from torch import Tensor

START_OF_TASK, START_OF_IMAGE, END_OF_IMAGE, ACT, FIRST_CODE = range(5)
"""Token ids, counted from the end of the language model's own words: four markers, then the image codes."""


def lay_out(
    words: Tensor, kept: Tensor, codes: Tensor, n_actions: int, n_words: int
) -> tuple[Tensor, Tensor, Tensor, slice, slice]:
    """Return the sequence [task, words, image, codes, end of image, actions] (UP-VLA, Section 3).

    Attention of words and actions is causal; that of the image is bidirectional over the whole sequence. The output at
    each code predicts the code at the same place of the future image.

    Args:
        words: token ids of the instruction, ``(B, W)`` int64, padded on the left.
        kept: ``(B, W)``, 0 where there is padding.
        codes: image codes, ``(B, N)`` int64.
        n_actions: number of action placeholders.
        n_words: rows of the language model's original embeddings.

    Returns:
        Token ids ``(B, L)`` int64; attention mask ``(B, 1, queries, keys)`` bool, True where a query attends to a key;
        position ids ``(B, L)`` int64, counted without padding; and where the image codes and the placeholders are.
    """
    n, (width, n_codes) = len(words), (words.shape[1], codes.shape[1])
    mark = torch.full_like(words[:, :1], n_words)
    parts = [
        mark + START_OF_TASK,
        words,
        mark + START_OF_IMAGE,
        codes + n_words + FIRST_CODE,
        mark + END_OF_IMAGE,
        (mark + ACT).expand(n, n_actions),
    ]
    ids = torch.cat(parts, dim=1)  # (B, L)
    length, image = ids.shape[1], slice(width + 1, width + n_codes + 3)
    real = torch.ones_like(ids, dtype=torch.bool)
    real[:, 1 : width + 1] = kept.bool()
    mask = torch.ones(length, length, dtype=torch.bool, device=ids.device).tril()
    mask[image] = True
    mask = mask & real.unsqueeze(1) | torch.eye(length, dtype=torch.bool, device=ids.device)
    in_image, in_actions = slice(image.start + 1, image.stop - 1), slice(length - n_actions, length)
    return ids, mask.unsqueeze(1), real.cumsum(1) - 1, in_image, in_actions
