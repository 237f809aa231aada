"""The two attentions of ObAct: in space over the cells of an image, in time over the observation
history.

Both have positions among their values: `SpatialAttention` averages viewing rays, `PositionReadout`
averages the positions sighted in earlier frames. `TemporalBlock` is an ordinary causal transformer
block with a bias by age.
"""

import torch
from einops import einsum, rearrange
from torch import Tensor, nn

from .frames import gather_frames

AGE_STEP_S = 0.05
N_AGES = 128
"""A bias by age is learned at this many ages, this far apart, and interpolated between them: up to
6.35 s, and the same for all that is older, which policies with a shorter history never see. Not
tuned."""
SAME_TIME_S = 1e-3
"""Frames whose times differ by less are of the same time; none is as fast."""
REACH_CELLS = 2
"""Cells on each side of the peak of attention in space that count: about the size of a target that
is near."""
KEY_DIM = 16  # of a readout, which tells few frames apart
FIRST_AGES = 24
FIRST_DECAY = 0.3
"""Readouts begin by looking at ages spread over this many steps, with a bias that falls by so much
for each step from there: at the last 1.2 s, each at a few frames of its own. Not tuned."""


class SpatialAttention(nn.Module):
    """Where in the image: a learned query attends to cells of ``dim`` features, whose values are
    their viewing rays.

    A mean over the whole map would look between two things that may be the target, so only cells
    near the peak count.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.query = nn.Linear(dim, 1)

    def forward(self, cells: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Attend to cells ``(F, h, w, D)``, rows downwards. Return the ray (u to the right, v
        upwards, the image spans -1 to 1), ``(F, 2)``; the features there, ``(F, D)``; and the log
        attention, not cut to the peak, ``(F, h, w)``.
        """
        h, w = cells.shape[1:3]
        rays = cell_rays(h, w, cells.device)
        flat = rearrange(cells, "f h w d -> f (h w) d")
        heat = rearrange(self.query(flat), "f n 1 -> f n").log_softmax(-1)
        size = heat.new_tensor([2 / w, 2 / h])
        far = ((rays - rays[heat.argmax(-1)][:, None]).abs() > (REACH_CELLS + 0.5) * size).any(-1)
        weights = heat.masked_fill(far, float("-inf")).softmax(-1)
        ray = einsum(weights, rays.to(weights.dtype), "f n, n i -> f i")
        there = einsum(weights, flat, "f n, f n d -> f d")
        return ray, there, rearrange(heat, "f (h w) -> f h w", h=h)


def cell_rays(height: int, width: int, device: torch.device) -> Tensor:
    """Return the (u, v) of the cells' centers, row by row from the top, shape ``(height * width,
    2)``.
    """
    u = (torch.arange(width, device=device) + 0.5) / width * 2 - 1
    v = 1 - (torch.arange(height, device=device) + 0.5) / height * 2
    return rearrange(torch.stack(torch.meshgrid(u, v, indexing="xy"), dim=-1), "h w i -> (h w) i")


def out_of_sight(age_s: Tensor, hidden: Tensor) -> Tensor:
    """Return whether frame q must not attend to frame k, ``(B, T, T)``: to those that lie ahead,
    whose ``age_s`` ``(T, T)`` [s] is negative, and to others that are ``hidden``, ``(B, T)``.
    """
    others = ~torch.eye(len(age_s), dtype=torch.bool, device=hidden.device)
    return (age_s < -SAME_TIME_S) | (hidden[:, None] & others)


class AgeBias(nn.Module):
    """A bias on the attention logits of each head by the age of a frame."""

    def __init__(self, n_heads: int) -> None:
        super().__init__()
        self.table = nn.Parameter(torch.zeros(n_heads, N_AGES))

    def forward(self, age_s: Tensor) -> Tensor:
        """Map ages ``(Q, K)`` [s] to ``(heads, Q, K)``; negative ages use the bias of age 0."""
        index = (age_s / AGE_STEP_S).clamp(0, N_AGES - 1)
        lower = index.floor().long().clamp_max(N_AGES - 2)
        share = (index - lower)[..., None]
        younger = nn.functional.embedding(lower, self.table.T)
        older = nn.functional.embedding(lower + 1, self.table.T)
        return rearrange(torch.lerp(younger, older, share), "q k heads -> heads q k")


class TemporalBlock(nn.Module):
    """Causal self-attention over frames and a perceptron, each after a normalization; tokens are of
    size ``dim``.
    """

    def __init__(self, dim: int, n_heads: int) -> None:
        super().__init__()
        self.n_heads = n_heads
        self.norm_1 = nn.LayerNorm(dim)
        self.qkv = nn.Linear(dim, 3 * dim)
        self.bias = AgeBias(n_heads)
        self.out = nn.Linear(dim, dim)
        self.norm_2 = nn.LayerNorm(dim)
        self.mlp = nn.Sequential(nn.Linear(dim, 2 * dim), nn.GELU(), nn.Linear(2 * dim, dim))

    def forward(self, tokens: Tensor, age_s: Tensor, unseen: Tensor) -> Tensor:
        """Map tokens of T frames ``(B, T, D)`` to tokens; frame k is ``age_s[q, k]`` [s] older than
        frame q, which does not attend to it where it is ``unseen``, see `out_of_sight`.
        """
        q, k, v = rearrange(
            self.qkv(self.norm_1(tokens)), "b t (n h d) -> n b h t d", n=3, h=self.n_heads
        )
        bias = self.bias(age_s).to(q.dtype).masked_fill(unseen[:, None], float("-inf"))
        mixed = nn.functional.scaled_dot_product_attention(q, k, v, attn_mask=bias)
        tokens = tokens + self.out(rearrange(mixed, "b h t d -> b t (h d)"))
        return tokens + self.mlp(self.norm_2(tokens))


class PositionReadout(nn.Module):
    """Attentions of a decision over the frames before it, whose values are the positions sighted
    there.
    """

    def __init__(self, dim: int, n_points: int) -> None:
        super().__init__()
        self.n_points = n_points
        self.query = nn.Linear(dim, n_points * KEY_DIM)
        self.key = nn.Linear(dim, KEY_DIM)
        self.bias = AgeBias(n_points)
        with torch.no_grad():
            table = self.bias.table
            own = torch.linspace(0, FIRST_AGES, n_points, device=table.device)
            away = (torch.arange(N_AGES, device=table.device) - own[:, None]).abs()
            table.copy_(-FIRST_DECAY * away)

    def forward(
        self,
        tokens: Tensor,
        positions: Tensor,
        age_s: Tensor,
        unseen: Tensor,
        decided_at: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return positions ``(B, Q, J, 3)`` [m], and the weights of the frames in them, ``(B, Q, J,
        T)``.

        There are tokens ``(B, T, D)`` of T frames and positions ``(B, T, 3)`` [m] sighted in them;
        see `TemporalBlock.forward` for ``age_s`` and ``unseen``. Decisions are taken at frames
        ``decided_at``, ``(B, Q)``.
        """
        queries = self.query(gather_frames(tokens, decided_at))
        queries = rearrange(queries, "b q (j d) -> b q j d", j=self.n_points)
        bias = rearrange(self.bias(age_s), "j t s -> t j s")[decided_at]  # (B, Q, J, T)
        unseen = gather_frames(unseen, decided_at)
        bias = bias.masked_fill(unseen[:, :, None], float("-inf"))
        logits = einsum(queries, self.key(tokens), "b q j d, b s d -> b q j s") / KEY_DIM**0.5
        weights = (logits + bias).softmax(-1)
        return einsum(weights, positions, "b q j s, b s i -> b q j i"), weights
