"""The action head: what a context says about the next actions.

    base      mean of the chunk and the scale of its error, by regression (Laplace likelihood)
    denoiser  the chunk's deviation from that mean, in units of that scale, by diffusion

Time runs from t = 0, noise, to t = 1, data. The denoiser learns from signal and noise mixed as sin
and cos of t pi / 2 (variance preserving), and predicts the signal. Divided by the sum of these two
coefficients, the mixture is on the straight path of flow matching, on which Euler steps are those
of DDIM.
"""

import numpy as np
import torch
from einops import rearrange, repeat
from lerobot.policies.common.flow_matching import euler_integrate
from torch import Tensor, nn

from .layers import smooth_norm

NOISE_LEVELS = 2  # levels at which each action of a batch is denoised
PURE_NOISE_SHARE = 0.5  # share of those at pure noise, where sampling begins
# deviations are clipped to this many scales: an outlier would teach nothing but its own size
LARGEST_DEVIATION = 6.0
LOG_SCALES = (-4.0, 2.0)
"""Scales of the error are cut to these, from 2 % to seven standard deviations of an action: a chunk
that never varies would make the likelihood grow without end."""
SCALE_SIZE = 3.0
"""A group of entries weighs in the likelihood as if it had at most as many as a place: the joints
move together."""
BETA = 0.5
"""The likelihood is weighted by the scale to this power, or what is easily predicted would count
for nearly everything (beta-NLL; Seitzer et al., 2022)."""
NOISE_SEED = 0  # of the noise that chunks start from
MAX_SAMPLING = 100  # most steps, and most draws: what is repeated for every action
PHASES = tuple(2.0**i for i in range(-1, 7))
"""Frequencies in which time enters a denoiser, in half turns: up to 64 within its range."""


def frame_noise(tick: int, shape: tuple[int, ...], like: Tensor) -> Tensor:
    """Return normal noise that is a function of a tick's number alone, in the type of ``like``.

    So what a policy does follows from what it sees: batch size, order, interruption and machine
    change nothing.
    """
    drawn = np.random.default_rng((NOISE_SEED, tick)).standard_normal(shape, dtype=np.float32)
    return torch.from_numpy(drawn).to(like)


class Denoiser(nn.Module):
    """Variance-preserving diffusion that predicts the signal: a residual perceptron over the
    ``size`` numbers of a chunk, in a context of ``context`` numbers.
    """

    def __init__(self, size: int, context: int, width: int = 128, n_blocks: int = 2) -> None:
        super().__init__()
        self.time = nn.Linear(2 * len(PHASES), width)
        self.chunk = nn.Linear(size, width)
        self.context = nn.Linear(context, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(
                nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width)
            )
            for _ in range(n_blocks)
        )
        self.out = nn.Linear(width, size)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def read(self, context: Tensor) -> Tensor:
        """Embed contexts for `forward`, once for all times, ``(R, context) -> (R, W)``."""
        return self.context(context)

    def forward(self, chunk: Tensor, t: Tensor, read: Tensor) -> Tensor:
        """Predict chunks ``(R, H, A)`` from their mixtures with noise at times ``(R,)``; ``read``
        ``(R, W)`` is of their contexts.
        """
        phase = t[:, None] * torch.pi * torch.tensor(PHASES, device=t.device)
        time = self.time(torch.cat([phase.sin(), phase.cos()], dim=-1))
        x = self.chunk(chunk.flatten(1)) + time + read
        for block in self.blocks:
            x = x + block(x)
        return self.out(x).view_as(chunk)

    def error(self, target: Tensor, noise: Tensor, t: Tensor, read: Tensor) -> Tensor:
        """Return by how much the prediction for a mixture of target and noise is off, ``(R, H,
        A)``.
        """
        signal, spread = _mixing(t)
        return self(signal * target + spread * noise, t, read) - target

    def velocity(self, x: Tensor, t: Tensor, read: Tensor) -> Tensor:
        """Return the velocity of the straight path at ``x`` ``(R, H, A)`` and ``t`` ``(R,)``,
        towards the data.

        On the path ``x = t target + (1 - t) noise`` the velocity ``target - noise`` is ``(target -
        x) / (1 - t)``, and the network says what the target is. It expects ``sin(a) target + cos(a)
        noise``, which is ``x (sin(a) + cos(a))`` where ``tan(a) = t / (1 - t)``.
        """
        own = 2 / torch.pi * torch.atan2(t, 1 - t)  # its own time, a in units of pi / 2
        signal, spread = _mixing(own)
        return (self(x * (signal + spread), own, read) - x) / (1 - t)[:, None, None]


def _mixing(t: Tensor) -> tuple[Tensor, Tensor]:
    """Return how much of signal and noise is mixed at times ``(R,)``, ``(R, 1, 1)`` each."""
    angle = (t * torch.pi / 2)[:, None, None]
    return angle.sin(), angle.cos()


class ActionHead(nn.Module):
    """Regression of a chunk with the scale of its error; what that leaves is denoised.

    Args:
        context: numbers of a context.
        horizon: actions of a chunk, H.
        groups: sizes of the groups of an action's entries that are scaled together, of sum A: the
            palm and the fingers; one of all where actions are not relative to the palm.
        width: of the denoiser.
        n_steps: sampling steps.
        n_draws: chunks sampled for a decision; the first group follows their median.
        closing_quantile: of the draws, for the other group, the fingers: above 0.5 they rather
            close too early than too late.
    """

    def __init__(
        self,
        context: int,
        horizon: int,
        groups: list[int],
        *,
        width: int = 128,
        n_steps: int = 8,
        n_draws: int = 32,
        closing_quantile: float = 0.5,
    ) -> None:
        super().__init__()
        for name, value in (("n_steps", n_steps), ("n_draws", n_draws)):
            if not 1 <= value <= MAX_SAMPLING:
                raise ValueError(
                    f"head_options.{name} is {value}, but must be 1 to {MAX_SAMPLING}."
                )
        if not 0 <= closing_quantile < 1:
            raise ValueError(
                f"head_options.closing_quantile is {closing_quantile}, but must be 0 or more and "
                "below 1."
            )
        self.horizon = horizon
        self.groups = groups
        self.action_dim = sum(groups)
        self.n_steps = n_steps
        self.n_draws = n_draws
        self.closing_quantile = closing_quantile
        self.noise_shape = (horizon, self.action_dim)  # of the noise that a chunk starts from
        self.base = nn.Linear(context, horizon * (self.action_dim + len(groups)))
        self.denoiser = Denoiser(horizon * self.action_dim, context, width)

    def load_pretrained(self) -> None:
        """Load published weights: here there are none."""

    def regress(self, context: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean ``(R, H, A)`` and the log scale of its error by group, ``(R, H, G)``."""
        out = rearrange(self.base(context), "r (h a) -> r h a", h=self.horizon)
        mean, log_scale = out.split([self.action_dim, len(self.groups)], dim=-1)
        return mean, log_scale.clamp(*LOG_SCALES)

    def loss(self, context: Tensor, actions: Tensor, weight: Tensor) -> Tensor:
        """Return the loss of each row, ``(R,)``, for contexts ``(R, context)``, normalized actions
        ``(R, H, A)`` and their weights, 0 for padding, ``(R, H)``.
        """
        mean, log_scale = self.regress(context)
        by_group = (actions - mean).split(self.groups, dim=-1)
        errors = torch.stack([smooth_norm(e, 1e-8) for e in by_group], dim=-1)
        sizes = errors.new_tensor(self.groups).clamp_max(SCALE_SIZE)
        likelihood = errors * (-log_scale).exp() + sizes * log_scale
        likelihood = (likelihood * (BETA * log_scale).exp().detach()).mean(-1)  # (R, H)
        deviation = (actions - mean.detach()) / self._unit(log_scale).detach()
        deviation = deviation.clamp(-LARGEST_DEVIATION, LARGEST_DEVIATION)
        target = repeat(deviation, "r h a -> (r n) h a", n=NOISE_LEVELS)
        t = torch.rand(len(target), device=target.device)
        t = torch.where(torch.rand_like(t) < PURE_NOISE_SHARE, 0.0, t)
        read = repeat(self.denoiser.read(context), "r w -> (r n) w", n=NOISE_LEVELS)
        error = self.denoiser.error(target, torch.randn_like(target), t, read)
        error = rearrange(error.square().mean(-1), "(r n) h -> r n h", n=NOISE_LEVELS)
        return (likelihood * weight).mean(-1) + (error * weight[:, None]).mean((1, 2))

    def _unit(self, log_scale: Tensor) -> Tensor:
        """Return the scale of every entry, ``(R, H, G) -> (R, H, A)``."""
        scales = zip(log_scale.exp().split(1, dim=-1), self.groups, strict=True)
        return torch.cat([scale.expand(-1, -1, size) for scale, size in scales], dim=-1)

    def sample(self, context: Tensor, tick: int) -> Tensor:
        """Sample a chunk for every context, ``(R, context) -> (R, H, A)``.

        ``n_draws`` chunks start from the noise of the tick, counted from the start of the episode.
        Of these, each entry of the first group takes the median, and of the other one the
        ``closing_quantile``.
        """
        n = self.n_draws
        noise = frame_noise(tick, (n, *self.noise_shape), context)
        start = repeat(noise, "n h a -> (r n) h a", r=len(context))
        draws = self.denoise(context, start, self.n_steps)
        draws = rearrange(draws, "(r n) h a -> n r h a", n=n).sort(dim=0).values
        first, rest = draws.split([self.groups[0], self.action_dim - self.groups[0]], dim=-1)
        return torch.cat([first[n // 2], rest[int(n * self.closing_quantile)]], dim=-1)

    def denoise(self, context: Tensor, start: Tensor, n_steps: int) -> Tensor:
        """Return the chunks ``(R * N, H, A)`` that noise ``start`` ``(R * N, H, A)`` becomes in
        contexts ``(R, context)``, N in each.
        """
        mean, log_scale = self.regress(context)
        n = len(start) // max(1, len(context))
        read, mean, unit = (
            x.repeat_interleave(n, dim=0)
            for x in (self.denoiser.read(context), mean, self._unit(log_scale))
        )

        # LeRobot's loop runs from time 1, noise, to 0, data
        def towards_noise(x: Tensor, time: Tensor) -> Tensor:
            return -self.denoiser.velocity(x, (1 - time).to(x), read)

        return mean + unit * euler_integrate(towards_noise, start, n_steps)
