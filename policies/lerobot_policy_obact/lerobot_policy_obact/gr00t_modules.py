"""Building blocks of GR00T-N1.5's action head: independent code with the released parameter names and shapes.

Names inside the modules (``attn1``, ``to_out.0``, ``ff.net.0.proj``, ``W``, ``b``) are those of the
checkpoint; a released state dict loads into them without renaming. Shapes: action-side tokens ``(B, L, D)``,
vision-language tokens ``(B, S, C)``, embodiment ids ``(B,)``.
"""

import math
from collections import OrderedDict

import torch
import torch.nn.functional as F
from torch import Tensor, nn

N_TIME_FEATURES = 256


class CategorySpecificLinear(nn.Module):
    """One linear layer per embodiment, selected by id.

    Args:
        n_categories: number of embodiments.
        n_in: input features.
        n_out: output features.
    """

    def __init__(self, n_categories: int, n_in: int, n_out: int) -> None:
        super().__init__()
        self.W = nn.Parameter(0.02 * torch.randn(n_categories, n_in, n_out))
        self.b = nn.Parameter(torch.zeros(n_categories, n_out))

    def forward(self, x: Tensor, category: Tensor) -> Tensor:
        """Map ``(B, L, n_in)`` to ``(B, L, n_out)`` with the layer of each row's category ``(B,)``."""
        return torch.baddbmm(self.b[category][:, None], x, self.W[category])


class CategorySpecificMLP(nn.Module):
    """Two layers per embodiment with a ReLU between.

    Args:
        n_categories: number of embodiments.
        n_in: input features.
        n_hidden: hidden features.
        n_out: output features.
    """

    def __init__(self, n_categories: int, n_in: int, n_hidden: int, n_out: int) -> None:
        super().__init__()
        self.layer1 = CategorySpecificLinear(n_categories, n_in, n_hidden)
        self.layer2 = CategorySpecificLinear(n_categories, n_hidden, n_out)

    def forward(self, x: Tensor, category: Tensor) -> Tensor:
        """Map ``(B, L, n_in)`` to ``(B, L, n_out)``."""
        return self.layer2(F.relu(self.layer1(x, category)), category)


class MultiEmbodimentActionEncoder(nn.Module):
    """Embeds noisy actions together with the flow time, per embodiment.

    Args:
        action_dim: size of a padded action.
        width: size of an action token.
        n_categories: number of embodiments.
    """

    def __init__(self, action_dim: int, width: int, n_categories: int) -> None:
        super().__init__()
        self.width = width
        self.W1 = CategorySpecificLinear(n_categories, action_dim, width)
        self.W2 = CategorySpecificLinear(n_categories, 2 * width, width)
        self.W3 = CategorySpecificLinear(n_categories, width, width)

    def forward(self, actions: Tensor, time_bucket: Tensor, category: Tensor) -> Tensor:
        """Map actions ``(B, H, A)`` at integer times ``(B,)`` to tokens ``(B, H, D)``."""
        tokens = self.W1(actions, category)
        rate = torch.exp(-torch.arange(self.width // 2, device=actions.device) * math.log(10000.0) / (self.width // 2))
        angle = time_bucket.float()[:, None] * rate  # (B, D/2)
        time = torch.cat([angle.sin(), angle.cos()], dim=-1)[:, None].expand_as(tokens)  # (B, D) -> (B, H, D)
        return self.W3(F.silu(self.W2(torch.cat([tokens, time.to(tokens.dtype)], dim=-1), category)), category)


class TimestepEncoder(nn.Module):
    """Embeds the integer flow time for the adaptive norms.

    Args:
        width: size of the embedding.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.timestep_embedder = nn.ModuleDict()
        self.timestep_embedder["linear_1"] = nn.Linear(N_TIME_FEATURES, width)
        self.timestep_embedder["linear_2"] = nn.Linear(width, width)

    def forward(self, time_bucket: Tensor) -> Tensor:
        """Map integer times ``(B,)`` to ``(B, D)``."""
        half = N_TIME_FEATURES // 2
        rate = torch.exp(-math.log(10000.0) * torch.arange(half, device=time_bucket.device) / (half - 1))
        angle = time_bucket.float()[:, None] * rate
        features = torch.cat([angle.cos(), angle.sin()], dim=-1)  # (B, 256)
        first, second = self.timestep_embedder["linear_1"], self.timestep_embedder["linear_2"]
        dtype = next(first.parameters()).dtype
        return second(F.silu(first(features.to(dtype))))


class AdaLayerNorm(nn.Module):
    """Layer norm whose scale and shift come from the time embedding.

    Args:
        width: token size.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.linear = nn.Linear(width, 2 * width)
        self.norm = nn.LayerNorm(width, eps=1e-5, elementwise_affine=False)

    def forward(self, x: Tensor, time: Tensor) -> Tensor:
        """Normalise ``(B, L, D)``, given the time ``(B, D)``."""
        scale, shift = self.linear(F.silu(time))[:, None].chunk(2, dim=-1)  # (B, 1, D) each
        return self.norm(x) * (1 + scale) + shift


class HeadAttention(nn.Module):
    """Multi-head attention whose head size is independent of the token size.

    Args:
        width: token size of queries and output.
        n_heads: heads.
        head_dim: size of a head.
        memory_dim: token size of keys and values.
        dropout: dropout probability of the output.
    """

    def __init__(self, width: int, n_heads: int, head_dim: int, memory_dim: int, dropout: float) -> None:
        super().__init__()
        self.n_heads = n_heads
        inner = n_heads * head_dim
        self.to_q = nn.Linear(width, inner)
        self.to_k = nn.Linear(memory_dim, inner)
        self.to_v = nn.Linear(memory_dim, inner)
        self.to_out = nn.ModuleList([nn.Linear(inner, width), nn.Dropout(dropout)])

    def forward(self, x: Tensor, memory: Tensor) -> Tensor:
        """Attend from queries ``(B, L, D)`` to a memory ``(B, S, C)``, without a mask, as in the original."""
        q, k, v = (
            t.unflatten(-1, (self.n_heads, -1)).transpose(1, 2)  # (B, L, heads*d) -> (B, heads, L, d)
            for t in (self.to_q(x), self.to_k(memory), self.to_v(memory))
        )
        out = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)  # (B, L, heads*d)
        return self.to_out[1](self.to_out[0](out))


class FeedForward(nn.Module):
    """GELU network of four times the width.

    Args:
        width: token size.
        dropout: dropout probability.
    """

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        entry = nn.Sequential(OrderedDict(proj=nn.Linear(width, 4 * width)))
        # The dropouts keep the released numbering of the linear layers: net.0.proj and net.2.
        self.net = nn.ModuleList([entry, nn.Dropout(dropout), nn.Linear(4 * width, width), nn.Dropout(dropout)])

    def forward(self, x: Tensor) -> Tensor:
        """Map ``(B, L, D)`` to ``(B, L, D)``."""
        hidden = F.gelu(self.net[0](x), approximate="tanh")
        return self.net[3](self.net[2](self.net[1](hidden)))


class TransformerBlock(nn.Module):
    """Attention and feed-forward, each with a norm before and a residual around it.

    Args:
        n_heads: heads.
        head_dim: size of a head; tokens have ``n_heads * head_dim``.
        memory_dim: token size of keys and values.
        dropout: dropout probability.
        adaptive: whether the first norm is modulated by the time; the second has parameters only if it is not.
    """

    def __init__(self, n_heads: int, head_dim: int, memory_dim: int, dropout: float, adaptive: bool) -> None:
        super().__init__()
        width = n_heads * head_dim
        self.norm1 = AdaLayerNorm(width) if adaptive else nn.LayerNorm(width)
        self.attn1 = HeadAttention(width, n_heads, head_dim, memory_dim, dropout)
        self.norm3 = nn.LayerNorm(width, elementwise_affine=not adaptive)
        self.ff = FeedForward(width, dropout)
        self.final_dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, memory: Tensor | None = None, time: Tensor | None = None) -> Tensor:
        """Update ``(B, L, D)`` by attention to ``memory`` ``(B, S, C)``, or to itself where there is none."""
        h = self.norm1(x) if time is None else self.norm1(x, time)
        x = x + self.final_dropout(self.attn1(h, h if memory is None else memory))
        return x + self.ff(self.norm3(x))


class Gr00tDiT(nn.Module):
    """Transformer blocks that attend alternately to the vision-language tokens and to the action-side tokens.

    Args:
        n_layers: blocks; even ones attend to the memory.
        n_heads: heads.
        head_dim: size of a head.
        memory_dim: size of a vision-language token.
        output_dim: size of an output token.
        dropout: dropout probability.
    """

    def __init__(
        self, n_layers: int, n_heads: int, head_dim: int, *, memory_dim: int, output_dim: int, dropout: float
    ) -> None:
        super().__init__()
        width = n_heads * head_dim
        self.timestep_encoder = TimestepEncoder(width)
        self.transformer_blocks = nn.ModuleList(
            TransformerBlock(n_heads, head_dim, width if i % 2 else memory_dim, dropout, adaptive=True)
            for i in range(n_layers)
        )
        self.norm_out = nn.LayerNorm(width, eps=1e-6, elementwise_affine=False)
        self.proj_out_1 = nn.Linear(width, 2 * width)
        self.proj_out_2 = nn.Linear(width, output_dim)

    def forward(self, x: Tensor, memory: Tensor, time_bucket: Tensor) -> Tensor:
        """Map ``(B, L, D)`` to ``(B, L, output_dim)``, given memory ``(B, S, C)`` and integer times ``(B,)``."""
        time = self.timestep_encoder(time_bucket)
        for i, block in enumerate(self.transformer_blocks):
            x = block(x, None if i % 2 else memory, time)
        shift, scale = self.proj_out_1(F.silu(time))[:, None].chunk(2, dim=-1)
        return self.proj_out_2(self.norm_out(x) * (1 + scale) + shift)


class VisionLanguageAdapter(nn.Module):
    """Self-attention over the vision-language tokens.

    Args:
        n_layers: blocks.
        n_heads: heads.
        head_dim: size of a head.
        dropout: dropout probability.
    """

    def __init__(self, n_layers: int, n_heads: int, head_dim: int, dropout: float) -> None:
        super().__init__()
        width = n_heads * head_dim
        self.transformer_blocks = nn.ModuleList(
            TransformerBlock(n_heads, head_dim, width, dropout, adaptive=False) for _ in range(n_layers)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map ``(B, S, C)`` to ``(B, S, C)``."""
        for block in self.transformer_blocks:
            x = block(x)
        return x
