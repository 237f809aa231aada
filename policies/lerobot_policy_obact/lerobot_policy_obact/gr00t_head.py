"""GR00T-N1.5's action head, so that a policy can start from its weights as the paper's ObAct does.

Its layers are LeRobot's for GR00T N1.7. They are put together here as in the
``FlowmatchingActionHead`` of the released ``nvidia/GR00T-N1.5-3B``, with its names and shapes of
parameters; LeRobot no longer ships that.

**License.** The code here is Apache-2.0. The released *weights* are not: they come under NVIDIA's
own license, whose terms also bind what is derived from them. Read the model card before you share a
policy that started from them.

What the original does, kept here because its weights expect it:

* queries are ``[state (1), learned future tokens, noisy actions]``; even blocks
  attend to the vision-language tokens, odd blocks to the queries themselves;
* no attention mask anywhere;
* flow time 0 is noise and 1 is data, cut into 1000 integer buckets; ``t = (s - u) / s, u ~
  Beta(1.5, 1), s = 0.999``;
* dropout of 0.2 everywhere in training;
* states and actions are padded with zeros to 64 and 32 entries, and each embodiment has encoders
  and a decoder of its own.

What differs: the only vision-language token is ObAct's context, which has read images,
proprioception and history, so the state token holds zeros.
"""

import json
from pathlib import Path

import torch
import torch.nn.functional as F
from huggingface_hub import snapshot_download
from lerobot.policies.common.flow_matching import euler_integrate
from safetensors import safe_open
from torch import Tensor, nn

from .heads import frame_noise

BETA_ALPHA = 1.5
TIME_SCALE = 0.999
N_TIME_BUCKETS = 1000
CHECKPOINT_PREFIX = "action_head."
N_POSITIONS = 1024


class Gr00tHead(nn.Module):
    """Flow matching with the transformer of GR00T-N1.5; the defaults are the released sizes.

    Args:
        context: numbers of a context.
        horizon: actions of a chunk, H.
        groups: sizes of the groups of an action's entries, of sum A.
        checkpoint: folder or Hub name to start from; empty for random weights.
        embodiment: slot of the checkpoint to use; 31 is "new_embodiment". Only that one is kept.
        n_layers: transformer blocks.
        n_heads: heads of the transformer.
        head_dim: size of a head.
        hidden_dim: size of its output tokens and of the encoders' hidden layer.
        memory_dim: size of a vision-language token, to which the context is projected.
        n_adapter_layers: self-attention blocks over the vision-language tokens.
        n_adapter_heads: heads of those; ``memory_dim`` must be a multiple.
        n_future_tokens: learned query tokens.
        max_state_dim, max_action_dim: sizes to which states and actions are padded.
        dropout: dropout probability.
        n_steps: Euler steps of a chunk.
    """

    def __init__(
        self,
        context: int,
        horizon: int,
        groups: list[int],
        *,
        checkpoint: str = "",
        embodiment: int = 31,
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
        from lerobot.policies.groot.action_head.cross_attention_dit import (
            DiT,
            SelfAttentionTransformer,
        )
        from lerobot.policies.groot.groot_n1_7 import (
            CategorySpecificMLP,
            MultiEmbodimentActionEncoder,
        )

        super().__init__()
        self.horizon = horizon
        self.action_dim = sum(groups)
        self.n_steps = n_steps
        if self.action_dim > max_action_dim:
            raise ValueError(
                f"the action has {self.action_dim} entries, but the gr00t head takes at most "
                f"{max_action_dim}."
            )
        self.checkpoint = checkpoint
        self.embodiment = embodiment
        self.max_state_dim = max_state_dim
        self.max_action_dim = max_action_dim
        width = n_heads * head_dim
        self.condition_in = nn.Linear(context, memory_dim)
        self.model = DiT(
            num_attention_heads=n_heads,
            attention_head_dim=head_dim,
            output_dim=hidden_dim,
            num_layers=n_layers,
            dropout=dropout,
            positional_embeddings=None,
            interleave_self_attention=True,
            cross_attention_dim=memory_dim,
        )
        self.state_encoder = CategorySpecificMLP(1, max_state_dim, hidden_dim, width)
        self.action_encoder = MultiEmbodimentActionEncoder(max_action_dim, width, 1)
        self.action_decoder = CategorySpecificMLP(1, hidden_dim, hidden_dim, max_action_dim)
        self.future_tokens = nn.Embedding(n_future_tokens, width)
        self.position_embedding = nn.Embedding(N_POSITIONS, width)
        self.vlln = nn.LayerNorm(memory_dim)
        self.vl_self_attention = SelfAttentionTransformer(
            num_attention_heads=n_adapter_heads,
            attention_head_dim=memory_dim // n_adapter_heads,
            num_layers=n_adapter_layers,
            dropout=dropout,
            positional_embeddings=None,
        )
        for embedding in (self.future_tokens, self.position_embedding):
            nn.init.normal_(embedding.weight, std=0.02)

    def loss(self, context: Tensor, actions: Tensor, weight: Tensor) -> Tensor:
        """See `ActionHead.loss`; the padding of the action is excluded."""
        target = F.pad(actions, (0, self.max_action_dim - actions.shape[-1]))
        u = torch.rand(len(target), device=target.device) ** (1 / BETA_ALPHA)
        t = (TIME_SCALE - u) / TIME_SCALE
        noise = torch.randn_like(target)
        error = self.velocity(
            torch.lerp(noise, target, t[:, None, None]), t, self.memory(context)
        ) - (target - noise)
        return (error.square()[..., : self.action_dim].mean(-1) * weight).mean(-1)

    @property
    def noise_shape(self) -> tuple[int, int]:
        """Shape of the noise that a chunk starts from."""
        return self.horizon, self.max_action_dim

    def sample(self, context: Tensor, tick: int) -> Tensor:
        """See `ActionHead.sample`."""
        start = frame_noise(tick, (1, *self.noise_shape), context)
        return self.denoise(context, start.expand(len(context), -1, -1), self.n_steps)

    def denoise(self, context: Tensor, start: Tensor, n_steps: int) -> Tensor:
        """See `ActionHead.denoise`; ``start`` is noise of the padded action."""
        memory = self.memory(context)

        def towards_noise(x: Tensor, time: Tensor) -> Tensor:
            return -self.velocity(x, 1 - time, memory)

        return euler_integrate(towards_noise, start, n_steps)[..., : self.action_dim]

    def memory(self, context: Tensor) -> Tensor:
        """Return the vision-language token that the transformer attends to, ``(R, 1,
        memory_dim)``.
        """
        return self.vl_self_attention(self.vlln(self.condition_in(context)[:, None]))

    def velocity(self, x: Tensor, t: Tensor, memory: Tensor) -> Tensor:
        """Predict the flow velocity of noisy padded chunks ``(R, H, max_action_dim)`` at times
        ``(R,)``.
        """
        bucket = (t * N_TIME_BUCKETS).long()
        slot = torch.zeros(len(x), dtype=torch.long, device=x.device)
        state = x.new_zeros(len(x), 1, self.max_state_dim)
        actions = (
            self.action_encoder(x, bucket, slot) + self.position_embedding.weight[: x.shape[1]]
        )
        future = self.future_tokens.weight.expand(len(x), -1, -1)
        queries = torch.cat(
            [self.state_encoder(state, slot), future.to(actions.dtype), actions], dim=1
        )
        return self.action_decoder(self.model(queries, memory, bucket), slot)[:, -x.shape[1] :]

    def load_pretrained(self) -> None:
        """Load the weights of ``checkpoint``, if one is given.

        Raises:
            ValueError: if the checkpoint's head differs from this one, naming the first difference,
                or lacks the embodiment.
        """
        if not self.checkpoint:
            return
        state = {
            key: self._own_slot(key, value)
            for key, value in read_action_head(self.checkpoint).items()
        }
        own = {
            key: value
            for key, value in self.state_dict().items()
            if not key.startswith("condition_in.")
        }
        for key in sorted(own.keys() | state.keys()):
            shapes = [tuple(d[key].shape) if key in d else None for d in (state, own)]
            if shapes[0] != shapes[1]:
                raise ValueError(
                    f"{self.checkpoint}: {key} is {shapes[0]}, but this gr00t head has {shapes[1]}."
                )
        self.load_state_dict(state, strict=False)

    def _own_slot(self, key: str, value: Tensor) -> Tensor:
        if not key.startswith(("state_encoder.", "action_encoder.", "action_decoder.")):
            return value
        if not 0 <= self.embodiment < len(value):
            raise ValueError(
                f"embodiment is {self.embodiment}, but must be 0 to {len(value) - 1} "
                f"({self.checkpoint})."
            )
        return value[self.embodiment : self.embodiment + 1]


def read_action_head(source: str) -> dict[str, Tensor]:
    """Read the action head's tensors from a GR00T-N1.5 checkpoint, by name, without the
    checkpoint's prefix.

    Args:
        source: folder, or Hub name, with ``model.safetensors`` or its shards and their index.

    Raises:
        ValueError: if there is no action head in it.
    """
    patterns = ["*.safetensors", "*.json"]
    folder = (
        Path(source)
        if Path(source).is_dir()
        else Path(snapshot_download(source, allow_patterns=patterns))
    )
    index = folder / "model.safetensors.index.json"
    shards = (
        set(json.loads(index.read_text())["weight_map"].values())
        if index.is_file()
        else {"model.safetensors"}
    )
    state = {}
    for shard in sorted(shards):
        with safe_open(folder / shard, framework="pt") as tensors:
            names = [name for name in tensors.keys() if name.startswith(CHECKPOINT_PREFIX)]  # noqa: SIM118
            state |= {
                name.removeprefix(CHECKPOINT_PREFIX): tensors.get_tensor(name) for name in names
            }
    if not state:
        raise ValueError(
            f"{source} has no tensor named '{CHECKPOINT_PREFIX}...': it is no GR00T-N1.5 "
            f"checkpoint."
        )
    return state
