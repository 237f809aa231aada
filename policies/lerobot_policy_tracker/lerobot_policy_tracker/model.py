"""The network: frames -> tokens -> spatiotemporal attention -> condition of the action head."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .backbones import backbones
from .configuration_tracker import TrackerConfig
from .decisions import Decisions
from .frames import EncodedFrames
from .heads import ActionSpec, Condition, heads
from .memory import build_memory
from .observation import Observation
from .privileged import PositionProbe
from .sightings import Sightings
from .text import ByteTextEncoder
from .track import MotionEncoder, Track


class TrackerModel(nn.Module):
    """All trained parts: encoders of images, proprioception and text, attention, action head and position probe.

    Args:
        config: the policy's config, with its features filled in.
    """

    def __init__(self, config: TrackerConfig) -> None:
        super().__init__()
        width, n_heads = config.width, config.n_attention_heads
        self.backbone = backbones.build(config.backbone, width, options=config.backbone_options)
        if config.motion and not self.backbone.sees_motion:
            raise ValueError(f"motion is True, but backbone {config.backbone!r} takes one image at a time.")
        n_cameras = len(config.image_features)
        if self.backbone.n_cameras not in (None, n_cameras):
            raise ValueError(
                f"backbone {config.backbone!r} needs {self.backbone.n_cameras} cameras, got {n_cameras}: "
                f"{', '.join(config.image_features)}."
            )
        self.camera = nn.Parameter(0.02 * torch.randn(n_cameras, 1, width))
        self.proprioception = nn.Sequential(nn.Linear(config.state_dim, width), nn.SiLU(), nn.Linear(width, width))
        self.text = None if self.backbone.reads_text else ByteTextEncoder(width)
        self.memory = build_memory(config)
        self.motion = MotionEncoder(width) if self.backbone.locates else None
        spec = ActionSpec(
            config.horizon, config.action_dim, config.state_dim, width, n_heads, config.dropout,
            config.fps, config.latency_frames,
        )  # fmt: skip
        self.head = heads.build(config.head, spec, options=config.head_options)
        self.probe = (
            PositionProbe(width, config.relative_dims) if config.privileged_key and config.privileged_weight else None
        )

    def load_pretrained(self) -> None:
        """Start from the published weights of backbone and head, where their options name any."""
        self.backbone.load_pretrained()
        self.head.load_pretrained()

    def compile_parts(self, backend: str) -> None:
        """Compile backbone, attention and the parts of the head with ``torch.compile``, each on its own.

        Args:
            backend: name of a ``torch.compile`` backend.
        """
        for part in (self.backbone, self.memory, *self.head.children()):
            part.compile(backend=backend)

    def track(self, frames: EncodedFrames, decisions: Decisions) -> Track | None:
        """Return where the target of each wanted decision is, if the backbone locates it; nothing of it is learned."""
        if self.motion is None:
            return None
        return Track.of(frames, decisions, self.backbone.cameras(frames.position[..., :3]))

    def sightings(self, frames: EncodedFrames) -> Sightings:
        """Return where the target was seen in all frames, padding included, for a backbone that locates it."""
        return Sightings.of(frames, self.backbone.cameras(frames.position[..., :3]))

    def conditions(self, frames: EncodedFrames, decisions: Decisions, track: Track | None = None) -> Condition:
        """Fuse the window of each wanted decision into the condition of its chunk, ``R`` rows ordered by sample.

        Args:
            frames: encoded frames.
            decisions: which are wanted.
            track: what `track` returned for them, if it is known.
        """
        fused = self.memory(frames.tokens, decisions)  # (R, N, D)
        if self.text is not None:
            text_tokens = decisions.of_sample(self.text(frames.texts))  # (B, 1, D) -> (R, 1, D)
            fused = torch.cat([fused, text_tokens.to(fused.dtype)], dim=1)
        track = self.track(frames, decisions) if track is None else track
        return Condition(fused, decisions.current(frames.proprioception), decisions.current(frames.position), track)

    def encode(self, observation: Observation) -> EncodedFrames:
        """Encode each frame independently into the tokens of its images and one token of proprioception."""
        return self.encode_looks(observation, self.look(observation))

    def look(self, observation: Observation) -> Tensor:
        """Return the backbone's looks at the images, ``(B, T, C, ...)``."""
        shape, images = observation.images.shape[:3], observation.images
        n_images = shape[1] * shape[2]
        texts = [text for text in observation.texts for _ in range(n_images)] if self.text is None else None
        return self.backbone.look(images.flatten(0, 2), texts).unflatten(0, shape)

    def encode_looks(self, observation: Observation, looks: Tensor) -> EncodedFrames:
        """Encode frames whose images have been looked at; the images themselves are not used.

        Args:
            observation: the frames.
            looks: what `look` returned, shape ``(B, T, C, ...)``.
        """
        image_tokens = self.backbone.tokens(looks.flatten(0, 2)).unflatten(0, looks.shape[:3])  # (B, T, C, n, D)
        image_tokens = image_tokens + self.camera
        sightings = looks[:, :, :0, :0]
        if self.motion is not None:
            sightings = self.backbone.sightings(looks, observation.position[..., :3])
            image_tokens = image_tokens + self.motion(sightings, observation.position[:, :, None])[..., None, :]
        proprio_tokens = self.proprioception(observation.proprioception)[:, :, None]  # (B, T, 1, D)
        tokens = torch.cat([image_tokens.flatten(2, 3), proprio_tokens.to(image_tokens.dtype)], dim=2)  # N = C*n + 1
        return EncodedFrames(
            tokens, observation.proprioception, observation.position, observation.keep, observation.watching,
            sightings, observation.texts,
        )  # fmt: skip
