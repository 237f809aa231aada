"""The network: encoder -> attention in space -> attention in time -> forecast -> generative action
head.

`ObActModel.encode_images` finds the target in the newest images (`encoders`); `encode_history` lets
a decision attend to the frames before it and forecasts the target (`belief`); `condition` picks
from that where to meet it; the head samples actions relative to that place (`heads`).
"""

from typing import Any, cast

import torch
from einops import einsum, rearrange, repeat
from lerobot.utils.constants import ACTION
from torch import Tensor, nn

from .attention import Memory
from .belief import FAR, FORECAST_FRAMES, Belief, Frames, Outlook
from .configuration_obact import HEADS, ObActConfig
from .encoders import ENCODERS, Encoder
from .heads import perceptron

N_FEATURES = 64  # numbers of the belief that the head reads beside the forecast


class ObActModel(nn.Module):
    """The network; ``config`` has its features and its rig filled in."""

    action_mean: Tensor
    action_std: Tensor
    state_mean: Tensor
    state_std: Tensor

    def __init__(self, config: ObActConfig) -> None:
        super().__init__()
        assert config.action_feature is not None
        assert config.input_features is not None
        n_actions, n_relative = config.action_feature.shape[0], config.relative_dims
        n_state = sum(config.input_features[key].shape[0] for key in config.state_keys)
        self.config = config
        encoders = [
            ENCODERS[config.encoder](**_options(config.encoder_options, key))
            for key in config.cameras
        ]
        self.encoders = nn.ModuleList(encoders).requires_grad_(not config.freeze_encoder)
        self.belief = Belief(config, sum(encoder.embedding for encoder in encoders))
        self.features = nn.Linear(config.dim, N_FEATURES)
        n_inputs = n_state
        if config.forecasts:
            n_inputs = 4 * len(FORECAST_FRAMES) + (n_state - n_relative if config.grips else 0)
        self.trunk = nn.Sequential(
            perceptron(n_inputs + N_FEATURES, config.width, config.width), nn.SiLU()
        )
        if config.forecasts:
            n_places, n_axes = (2, 3) if config.grips else (1, 1)
            self.when = nn.Linear(
                config.width, config.horizon * n_axes * n_places * len(FORECAST_FRAMES)
            )
        groups = [size for size in (n_relative, n_actions - n_relative) if size]
        options = {"noise_seed": config.noise_seed} | config.head_options
        self.head = HEADS[config.head](config.width, config.horizon, groups, **options)
        for name, size in (("action", n_actions), ("state", n_state)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    def adopt_stats(self, stats: dict[str, dict[str, Any]]) -> None:
        """Take over LeRobot's statistics of the dataset; actions relative to the palm have mean
        0.
        """
        for name, keys in (("action", [ACTION]), ("state", self.config.state_keys)):
            mean, std = (
                torch.cat(
                    [
                        torch.as_tensor(stats[key][moment], dtype=torch.float32).flatten()
                        for key in keys
                    ]
                )
                for moment in ("mean", "std")
            )
            getattr(self, f"{name}_mean").copy_(mean)
            getattr(self, f"{name}_std").copy_(std.clamp_min(1e-3))
        self.action_mean[: self.config.relative_dims] = 0.0

    def load_pretrained(self) -> None:
        """Load the published weights that encoders and head name, if any."""
        for part in cast("list[Encoder]", [*self.encoders, self.head]):
            part.load_pretrained()

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.action_mean.device

    def encode_images(self, images: dict[str, Tensor], before: dict[str, Tensor]) -> Tensor:
        """Return what each camera saw, ``(F, C, 5 + E)``, in images ``(F, 3, H, W)``, RGB in [0,
        1].

        Those of the frame ``before`` only matter to encoders that see motion.
        """
        if self.config.sees_motion:
            images = {key: torch.cat([image, before[key]], dim=1) for key, image in images.items()}
        seen = [
            encoder(images[key])
            for encoder, key in zip(self.encoders, self.config.cameras, strict=True)
        ]
        return torch.stack(seen, dim=1)

    def encode_history(
        self, frames: Frames, rows: Tensor | None = None, memory: Memory | None = None
    ) -> Outlook:
        """Return what decisions at frames ``rows`` ``(B, Q)`` believe; without ``rows``, one at the
        last frame.

        A decision that sees ``n_obs_frames`` frames, not all, is given a window of its own. Where
        frames come a few at a time, ``memory`` keeps those before.
        """
        windowed = self.config.n_obs_frames is not None
        if windowed and memory is not None:
            frames = frames.remembered(memory)
        if rows is None:
            rows = torch.full(
                (len(frames.state), 1), len(frames.time_s) - 1, device=frames.state.device
            )
        if not windowed:
            return self.belief(frames, rows, memory)
        ages_s = torch.tensor(
            [-offset / self.config.rig.fps for offset in self.config.lookback], device=rows.device
        )
        last = rows.new_full((rows.numel(), 1), len(ages_s) - 1)
        outlook = self.belief(frames.windows(rows, ages_s), last)
        return outlook.map(lambda x: rearrange(x, "(b q) 1 ... -> b q ...", b=len(rows)))

    def condition(self, outlook: Outlook, palm: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return what the head reads, ``(R, C)``, and the places from which its actions count [m],
        ``(R, H, 3)``.

        Attention over the times of the forecast, whose values are positions, picks where to meet
        the target. To grip it, attention picks along each axis between the forecast and the places
        of a palm that moves along with the target. Without a forecast the actions count from the
        palm.

        Args:
            outlook: of R decisions, ``(R, ...)``.
            palm: where the palm will be when a command takes effect [m], ``(R, 3)``.
            state: of the robot, ``(R, S)``; with a forecast the head reads of it the joints, to
                grip, or nothing.
        """
        features, forecast = nn.functional.silu(self.features(outlook.features)), outlook.forecast
        state = (state - self.state_mean) / self.state_std
        if not self.config.forecasts:
            context = self.trunk(torch.cat([state, features], dim=-1))
            return context, repeat(palm, "r i -> r h i", h=self.config.horizon)
        unit = 0.1 + 0.3 * self.belief.ahead_s
        offset = (forecast - palm[:, None]) / unit[:, None]  # (R, K, 3)
        distance = offset.norm(dim=-1).clamp_max(FAR)
        joints = state[:, self.config.relative_dims :] if self.config.grips else state[:, :0]
        context = self.trunk(
            torch.cat([offset.clamp(-FAR, FAR).flatten(1), distance, features, joints], dim=-1)
        )
        if not self.config.grips:
            when = rearrange(self.when(context), "r (h k) -> r h k", h=self.config.horizon).softmax(
                -1
            )
            return context, when @ forecast
        along = palm[:, None] + forecast - forecast[:, :1]
        when = rearrange(
            self.when(context), "r (h i k) -> r h i k", h=self.config.horizon, i=3
        ).softmax(-1)
        return context, einsum(when, torch.cat([forecast, along], dim=1), "r h i k, r k i -> r h i")

    def act_once(self, outlook: Outlook, palm: Tensor, state: Tensor) -> Tensor:
        """Return actions ``(R, A)`` sampled in one step from fresh noise, for training; see
        `condition`.
        """
        context, origin = self.condition(outlook, palm, state)
        start = torch.randn(len(context), *self.head.noise_shape, device=context.device)
        return self.unnormalise(self.head.denoise(context, start, 1), origin)[:, 0]

    def normalise(self, actions: Tensor, origin: Tensor) -> Tensor:
        """Map actions ``(R, H, A)`` to what the head predicts; they count from ``origin`` ``(R, H,
        3)``.
        """
        return (actions - self._offset(origin)) / self.action_std

    def unnormalise(self, predicted: Tensor, origin: Tensor) -> Tensor:
        """Invert `normalise`."""
        return predicted * self.action_std + self._offset(origin)

    def _offset(self, origin: Tensor) -> Tensor:
        n = self.config.relative_dims
        return nn.functional.pad(origin[..., :n], (0, len(self.action_mean) - n)) + self.action_mean


def _options(options: dict[str, Any], camera: str) -> dict[str, Any]:
    """Return the options of the encoder for an image key, whose last part is the ``{view}`` in a
    text.
    """
    view = camera.rsplit(".", maxsplit=1)[-1]
    return {
        name: x.replace("{view}", view) if isinstance(x, str) else x for name, x in options.items()
    }
