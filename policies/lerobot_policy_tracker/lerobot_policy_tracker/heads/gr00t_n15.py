"""GR00T-N1.5's action head, so that a policy can start from its weights as the paper's the tracker does.

Independent code, compatible in parameter names, shapes and outputs with the ``FlowmatchingActionHead`` of the released
``nvidia/GR00T-N1.5-3B``, which LeRobot no longer ships.

**Licence.** The code here is Apache-2.0. The released *weights* are not: they come under NVIDIA's own
licence, whose terms also bind what is derived from them. Read the model card before you share a policy that
started from them.

What the original does, kept here because its weights expect it:

* queries are ``[state (1), learned future tokens, noisy actions]``; even blocks attend to the vision-language tokens,
  odd blocks to the queries themselves;
* no attention mask anywhere: padding tokens would be attended to, so none may be passed;
* flow time 0 is noise and 1 is data, cut into 1000 integer buckets; ``t = (s - u) / s, u ~ Beta(1.5, 1), s = 0.999``;
* dropout of 0.2 everywhere in training;
* states and actions are padded with zeros to 64 and 32 entries, and each embodiment has encoders and a decoder
  of its own. A single slot is kept by default; 32 of them would be 315 M parameters.
"""

from __future__ import annotations

import json
from pathlib import Path

import torch
import torch.nn.functional as F
from huggingface_hub import snapshot_download
from safetensors import safe_open
from torch import Tensor, nn

from .base import ActionSpec, ChunkHead, Condition, Guide, heads
from .flow import integrate
from .gr00t_modules import (
    CategorySpecificMLP,
    Gr00tDiT,
    MultiEmbodimentActionEncoder,
    VisionLanguageAdapter,
)

BETA_ALPHA, TIME_SCALE, N_TIME_BUCKETS = 1.5, 0.999, 1000
CHECKPOINT_PREFIX = "action_head."
N_POSITIONS = 1024


@heads.register("gr00t_n15")
class Gr00tN15Head(ChunkHead):
    """Flow matching with the transformer of GR00T-N1.5; the defaults are the released sizes.

    Args:
        spec: sizes of the head and of its inputs.
        checkpoint: folder or hub name to start from; "" starts from random weights.
        embodiment: slot of the checkpoint to use; 31 is "new_embodiment".
        n_embodiments: slots kept: 1 (only ``embodiment``) or as many as the checkpoint has.
        n_layers: transformer blocks.
        n_heads: heads of the transformer.
        head_dim: size of a head.
        hidden_dim: size of its output tokens and of the encoders' hidden layer.
        memory_dim: size of a vision-language token; condition tokens of another size are projected.
        n_adapter_layers: self-attention blocks over the vision-language tokens.
        n_adapter_heads: heads of those; ``memory_dim`` must be a multiple.
        n_future_tokens: learned query tokens.
        max_state_dim: size to which states are padded.
        max_action_dim: size to which actions are padded.
        dropout: dropout probability.
        n_steps: Euler steps of a chunk.
    """

    accepts_guide = True

    def __init__(
        self,
        spec: ActionSpec,
        *,
        checkpoint: str = "",
        embodiment: int = 31,
        n_embodiments: int = 1,
        n_layers: int = 16,
        n_heads: int = 32,
        head_dim: int = 48,
        hidden_dim: int = 1024,
        memory_dim: int = 2048,
        n_adapter_layers: int = 4,
        n_adapter_heads: int = 32,
        n_future_tokens: int = 32,
        max_state_dim: int = 64,
        max_action_dim: int = 32,
        dropout: float = 0.2,
        n_steps: int = 4,
    ) -> None:
        super().__init__(spec)
        for name, size, limit in (
            ("state", spec.state_dim, max_state_dim),
            ("action", spec.action_dim, max_action_dim),
        ):
            if size > limit:
                raise ValueError(f"the {name} has {size} entries, but the gr00t_n15 head takes at most {limit}.")
        self.checkpoint, self.embodiment, self.n_embodiments = checkpoint, embodiment, n_embodiments
        self.max_state_dim, self.max_action_dim, self.n_steps = max_state_dim, max_action_dim, n_steps
        width = n_heads * head_dim
        self.condition_in = nn.Identity() if spec.width == memory_dim else nn.Linear(spec.width, memory_dim)
        self.model = Gr00tDiT(
            n_layers, n_heads, head_dim, memory_dim=memory_dim, output_dim=hidden_dim, dropout=dropout
        )
        self.state_encoder = CategorySpecificMLP(n_embodiments, max_state_dim, hidden_dim, width)
        self.action_encoder = MultiEmbodimentActionEncoder(max_action_dim, width, n_embodiments)
        self.action_decoder = CategorySpecificMLP(n_embodiments, hidden_dim, hidden_dim, max_action_dim)
        self.future_tokens = nn.Embedding(n_future_tokens, width)
        self.position_embedding = nn.Embedding(N_POSITIONS, width)
        self.vlln = nn.LayerNorm(memory_dim)
        adapter_head_dim = memory_dim // n_adapter_heads
        self.vl_self_attention = VisionLanguageAdapter(n_adapter_layers, n_adapter_heads, adapter_head_dim, dropout)
        for embedding in (self.future_tokens, self.position_embedding):
            nn.init.normal_(embedding.weight, std=0.02)

    @property
    def noise_dim(self) -> int:
        """Size of the padded action, over which the flow is defined."""
        return self.max_action_dim

    def loss(self, actions: Tensor, condition: Condition) -> Tensor:
        """See `ChunkHead.loss`; the padding of the action is excluded."""
        target = F.pad(actions, (0, self.max_action_dim - actions.shape[-1]))
        u = torch.rand(len(target), device=target.device) ** (1 / BETA_ALPHA)
        t = (TIME_SCALE - u) / TIME_SCALE
        noise = torch.randn_like(target)
        x_t = torch.lerp(noise, target, t[:, None, None])
        error = self.velocity(x_t, t, self.memory(condition), condition.state) - (target - noise)
        return error.square()[..., : actions.shape[-1]]

    def sample(self, condition: Condition, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """See `ActionHead.sample`."""
        memory = self.memory(condition)
        chunk = integrate(lambda x, t: self.velocity(x, t, memory, condition.state), noise, self.n_steps, guide)
        return chunk[..., : self.spec.action_dim]

    def memory(self, condition: Condition) -> Tensor:
        """Return the vision-language tokens that the transformer attends to, shape ``(B, S, C)``."""
        return self.vl_self_attention(self.vlln(self.condition_in(condition.tokens)))

    def velocity(self, x: Tensor, t: Tensor, memory: Tensor, state: Tensor) -> Tensor:
        """Predict the flow velocity.

        Args:
            x: noisy padded chunk, shape ``(B, H, max_action_dim)``.
            t: flow times, shape ``(B,)``.
            memory: vision-language tokens, shape ``(B, S, C)``.
            state: normalised proprioception, shape ``(B, S)``.
        """
        bucket = (t * N_TIME_BUCKETS).long()
        slot = torch.full((len(x),), 0 if self.n_embodiments == 1 else self.embodiment, device=x.device)
        state = F.pad(state, (0, self.max_state_dim - state.shape[-1]))[:, None]  # (B, 1, max_state_dim)
        actions = self.action_encoder(x, bucket, slot) + self.position_embedding.weight[: x.shape[1]]
        future = self.future_tokens.weight.expand(len(x), -1, -1)
        queries = torch.cat([self.state_encoder(state, slot), future.to(actions.dtype), actions], dim=1)
        return self.action_decoder(self.model(queries, memory, bucket), slot)[:, -x.shape[1] :]

    def load_pretrained(self) -> None:
        """Load the weights of ``checkpoint``, if one is given.

        Raises:
            ValueError: if the checkpoint's head differs from this one, naming the first difference.
        """
        if not self.checkpoint:
            return
        state = read_action_head(self.checkpoint)
        if self.n_embodiments == 1:
            state = {key: self._own_slot(key, value) for key, value in state.items()}
        own = {key: value for key, value in self.state_dict().items() if not key.startswith("condition_in.")}
        for key in sorted(own.keys() | state.keys()):
            shapes = [tuple(d[key].shape) if key in d else None for d in (state, own)]
            if shapes[0] != shapes[1]:
                raise ValueError(f"{self.checkpoint}: {key} is {shapes[0]}, but this gr00t_n15 head has {shapes[1]}.")
        self.load_state_dict(state, strict=False)

    def _own_slot(self, key: str, value: Tensor) -> Tensor:
        per_embodiment = key.startswith(("state_encoder.", "action_encoder.", "action_decoder."))
        return value[self.embodiment : self.embodiment + 1] if per_embodiment else value


def read_action_head(source: str) -> dict[str, Tensor]:
    """Read the action head's tensors from a GR00T-N1.5 checkpoint.

    Args:
        source: folder, or hub name, with ``model.safetensors`` or its shards and their index.

    Returns:
        Tensors by name, without the checkpoint's prefix.

    Raises:
        ValueError: if there is no action head in it.
    """
    patterns = ["*.safetensors", "*.json"]
    folder = Path(source) if Path(source).is_dir() else Path(snapshot_download(source, allow_patterns=patterns))
    index = folder / "model.safetensors.index.json"
    shards = set(json.loads(index.read_text())["weight_map"].values()) if index.is_file() else {"model.safetensors"}
    state = {}
    for shard in sorted(shards):
        with safe_open(folder / shard, framework="pt") as tensors:
            names = [name for name in tensors.keys() if name.startswith(CHECKPOINT_PREFIX)]  # noqa: SIM118
            state |= {name.removeprefix(CHECKPOINT_PREFIX): tensors.get_tensor(name) for name in names}
    if not state:
        raise ValueError(f"{source} has no tensor named '{CHECKPOINT_PREFIX}...': it is no GR00T-N1.5 checkpoint.")
    return state
