"""Denoising diffusion (Ho et al., 2020) over the same transformer, with the schedulers of ``diffusers``.

Diffusion's own time runs from data (0) to noise (N); the transformer receives ``1 - k / N``, so that here too 0 is
noise and 1 is data.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from .base import ActionSpec, ChunkHead, Condition, Guide, heads
from .dit import DiT

SAMPLERS = ("ddim", "ddpm")


@heads.register("diffusion")
class DiffusionHead(ChunkHead):
    """Predicts the noise in a chunk.

    Args:
        spec: sizes of the head and of its inputs.
        n_layers: transformer blocks.
        sampler: "ddim" (deterministic) or "ddpm".
        n_train_steps: noise levels in training.
        n_steps: denoising steps of a chunk.
        n_draws: noise draws per chunk in training, see `FlowHead`.
        clip: largest normalised action that a denoised chunk may hold; bounds early estimates.
    """

    def __init__(
        self,
        spec: ActionSpec,
        *,
        n_layers: int = 4,
        sampler: str = "ddim",
        n_train_steps: int = 100,
        n_steps: int = 10,
        n_draws: int = 1,
        clip: float = 5.0,
    ) -> None:
        from diffusers.schedulers.scheduling_ddim import DDIMScheduler
        from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

        super().__init__(spec)
        if sampler not in SAMPLERS:
            raise ValueError(f"sampler is {sampler!r}, but must be one of {', '.join(SAMPLERS)}.")
        scheduler = DDIMScheduler if sampler == "ddim" else DDPMScheduler
        self.scheduler: Any = scheduler(
            num_train_timesteps=n_train_steps, beta_schedule="squaredcos_cap_v2", clip_sample_range=clip
        )
        self.n_train_steps, self.n_steps, self.n_draws = n_train_steps, n_steps, n_draws
        self.net = DiT(spec, n_layers)

    def loss(self, actions: Tensor, condition: Condition) -> Tensor:
        """See `ChunkHead.loss`."""
        target, condition = actions.repeat_interleave(self.n_draws, 0), condition.repeat(self.n_draws)
        level = torch.randint(0, self.n_train_steps, (len(target),), device=target.device)
        noise = torch.randn_like(target)
        error = self._predict(self.scheduler.add_noise(target, noise, level), level, condition) - noise
        return error.square().unflatten(0, (-1, self.n_draws)).mean(1)  # (B * draws, H, A) -> (B, H, A)

    def sample(self, condition: Condition, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """See `ActionHead.sample`; a guide is for flows and must be absent."""
        if guide is not None:
            raise ValueError("the diffusion head takes no guide: use head='flow' for real-time chunking.")
        self.scheduler.set_timesteps(self.n_steps, device=noise.device)
        # DDPM draws noise at every step; seeding it with the initial noise makes the chunk a function of it.
        generator = torch.Generator(noise.device).manual_seed(int(noise.double().abs().sum() * 1e6) % 2**31)
        x = noise
        for level in self.scheduler.timesteps:
            estimate = self._predict(x, level.expand(len(x)), condition)
            x = self.scheduler.step(estimate, level, x, generator=generator).prev_sample
        return x

    def _predict(self, x: Tensor, level: Tensor, condition: Condition) -> Tensor:
        return self.net(x, 1 - (level + 1) / self.n_train_steps, condition)
