"""The network: frames -> tokens -> spatiotemporal attention -> condition of the action head."""

from __future__ import annotations

import torch
from torch import nn

from .attention import SpatioTemporalAttention
from .backbones import backbones
from .configuration_obact import ObActConfig
from .decisions import Decisions
from .frames import EncodedFrames
from .heads import ActionSpec, Condition, heads
from .observation import Observation
from .privileged import PositionProbe
from .text import ByteTextEncoder


class ObActModel(nn.Module):
    """All trained parts: encoders of images, proprioception and text, attention, action head and position probe.

    Args:
        config: the policy's config, with its features filled in.
    """

    def __init__(self, config: ObActConfig) -> None:
        super().__init__()
        width, n_heads = config.width, config.n_attention_heads
        self.backbone = backbones.build(config.backbone, width, options=config.backbone_options)
        self.camera = nn.Parameter(0.02 * torch.randn(len(config.image_features), 1, width))
        self.proprioception = nn.Sequential(nn.Linear(config.state_dim, width), nn.SiLU(), nn.Linear(width, width))
        self.text = None if self.backbone.reads_text else ByteTextEncoder(width)
        self.attention = SpatioTemporalAttention(width, config.n_attention_layers, n_heads, config.dropout)
        spec = ActionSpec(config.horizon, config.action_dim, config.state_dim, width, n_heads, config.dropout)
        self.head = heads.build(config.head, spec, options=config.head_options)
        self.probe = PositionProbe(width, config.relative_dims) if config.privileged_key else None

    def load_pretrained(self) -> None:
        """Start from the published weights of backbone and head, where their options name any."""
        self.backbone.load_pretrained()
        self.head.load_pretrained()

    def compile_parts(self, backend: str) -> None:
        """Compile backbone, attention and the parts of the head with ``torch.compile``, each on its own.

        Args:
            backend: name of a ``torch.compile`` backend.
        """
        for part in (self.backbone, self.attention, *self.head.children()):
            part.compile(backend=backend)

    def conditions(self, frames: EncodedFrames, decisions: Decisions) -> Condition:
        """Fuse the window of each wanted decision into the condition of its chunk, ``R`` rows ordered by sample."""
        fused = self.attention(frames.tokens, decisions)  # (R, N, D)
        if self.text is not None:
            text_tokens = decisions.of_sample(self.text(frames.texts))  # (B, 1, D) -> (R, 1, D)
            fused = torch.cat([fused, text_tokens.to(fused.dtype)], dim=1)
        return Condition(fused, decisions.current(frames.proprioception))

    def encode(self, observation: Observation) -> EncodedFrames:
        """Encode each frame independently into the tokens of its images and one token of proprioception."""
        images = observation.images
        n_batch, n_frames, n_cameras = images.shape[:3]
        texts = [text for text in observation.texts for _ in range(n_frames * n_cameras)] if self.text is None else None
        image_tokens = self.backbone(images.flatten(0, 2), texts)  # (B*T*C, n, D)
        image_tokens = image_tokens.unflatten(0, (n_batch, n_frames, n_cameras)) + self.camera  # (B, T, C, n, D)
        proprio_tokens = self.proprioception(observation.proprioception)[:, :, None]  # (B, T, 1, D)
        tokens = torch.cat([image_tokens.flatten(2, 3), proprio_tokens.to(image_tokens.dtype)], dim=2)  # N = C*n + 1
        return EncodedFrames(
            tokens, observation.proprioception, observation.position, observation.keep, observation.texts
        )
