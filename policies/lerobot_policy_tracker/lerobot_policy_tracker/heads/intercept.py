"""A head for hands of limited speed: it predicts the target's path, and goes where the hand can first meet it.

The network predicts where the target will be at a few times, as a correction of the straight line through its latest
sightings, towards what other motion models expect and beyond, and how far the fingers must close. The chunk follows
from that by `reach.py` or `matching.py`: at a limit, *where* to go is a question for the network, and how fast is none.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..attention import Attention
from ..matching import matched_path
from ..reach import Reach, close_in_time, earliest_meeting, executed, first_contact, palm_path
from ..track import N_FITS, N_TRACK, Track
from .base import ActionSpec, Condition, Forecast, ForecastHead, Prefix, heads

KNOTS = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48, 60)
"""Frames ahead at which the path is predicted; a spline leads from one to the next."""
PALM_DIM = 3
ARRIVALS = ("straight", "matched")
CLOSED_QUANTILE = 0.7
"""Fingers that close too little lose the target, and fingers that close a little too much do not."""


@heads.register("intercept")
class InterceptHead(ForecastHead):
    """Forecast, meeting point, approach. Needs an eye, and states and actions in metres and radians.

    Args:
        spec: sizes of the head and of its inputs.
        palm_speed_m_s: the palm's greatest speed.
        joint_speed_rad_s: that of each finger joint.
        spare_frames: fingers are closed this long before the target is expected within reach of them. A target that
            nothing attaches would bounce off them: there it is 0.
        closing_frames: fingers close over at most this many frames.
        squeeze_rad: each joint is commanded this far beyond where it touches, so that it presses.
        seat_m: where the target should be in the hand, from the palm's centre.
        arrival: "straight" at full speed to the earliest meeting point, or "matched" to the target's velocity there.

    Raises:
        ValueError: if there is no such arrival.
    """

    accepts_prefix = True
    ahead_s: Tensor
    between: Tensor
    seat_m: Tensor

    def __init__(
        self,
        spec: ActionSpec,
        *,
        palm_speed_m_s: float = 0.5,
        joint_speed_rad_s: float = 20.0,
        spare_frames: int = 4,
        closing_frames: int = 8,
        squeeze_rad: float = 0.0,
        seat_m: tuple[float, ...] = (0.0, 0.0, 0.0),
        arrival: str = "straight",
    ) -> None:
        super().__init__(spec)
        if arrival not in ARRIVALS:
            raise ValueError(f"arrival is {arrival!r}, but must be one of {', '.join(ARRIVALS)}.")
        self.arrival = arrival
        self.reach = Reach(palm_speed_m_s / spec.fps, joint_speed_rad_s / spec.fps, spare_frames, closing_frames)
        self.squeeze_rad = squeeze_rad
        self.register_buffer("seat_m", torch.tensor(seat_m), persistent=False)
        width, n_knots, n_joints = spec.width, len(KNOTS), spec.action_dim - PALM_DIM
        self.sizes = [3 * n_knots, n_knots, (N_FITS - 1) * n_knots, n_joints]
        self.query = nn.Parameter(0.02 * torch.randn(1, 1, width))
        self.pool = Attention(width, spec.n_heads, spec.dropout)
        n_in = 2 * width + N_TRACK + n_joints
        self.hidden = nn.Sequential(nn.Linear(n_in, 2 * width), nn.SiLU(), nn.Linear(2 * width, width), nn.SiLU())
        self.out = nn.Linear(width, sum(self.sizes))
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.register_buffer("ahead_s", torch.tensor(KNOTS) / spec.fps, persistent=False)
        self.register_buffer("between", interpolation(KNOTS), persistent=False)

    def forecast(self, condition: Condition) -> Forecast:
        """See `ForecastHead.forecast`."""
        track, n = _track_of(condition), len(condition.tokens)
        pooled = self.pool(self.query.expand(n, -1, -1), condition.tokens)[:, 0]
        joints = self._joints(condition)
        context = torch.cat([condition.tokens[:, 0], pooled, track.features(), joints], dim=-1)
        bend, damping, share, closed = self.out(self.hidden(context)).split(self.sizes, dim=-1)
        ahead = self.ahead_s
        straight = track.along_line(ahead, torch.sigmoid(damping + 1 - ahead))
        led = track.along(ahead)[:, 1:] - straight[:, None]  # (R, N_FITS - 1, K, 3)
        turned = (share.unflatten(-1, led.shape[1:3])[..., None] * led).sum(1)
        bend = bend.unflatten(-1, (-1, 3)) * (0.05 + 0.5 * ahead[:, None])
        return Forecast(straight + turned + bend, closed)

    def _here(self, condition: Condition) -> Tensor:
        """Return where the hand is, its palm relative to itself, ``(B, A)``."""
        return torch.cat([torch.zeros_like(condition.position[:, :PALM_DIM]), self._joints(condition)], dim=-1)

    def _prefix(self, condition: Condition) -> Prefix:
        """Return what is executed before the chunk takes over; the hand stands still if nothing is known of it."""
        if condition.prefix is not None:
            return condition.prefix
        late, here = self.spec.latency_frames, self._here(condition)
        return Prefix(here[:, None].expand(-1, late, -1), torch.full((len(here),), late, device=here.device))

    def _approach(self, path: Tensor, turn_rad: Tensor) -> Tensor:
        """Return where palms will be on their way to targets on paths ``(B, F + 1, 3)``, of the same shape."""
        if self.arrival == "matched":
            return matched_path(path, self.reach, self.spec.fps)
        return palm_path(path, earliest_meeting(path, turn_rad, self.reach), self.reach)

    def _joints(self, condition: Condition) -> Tensor:
        return condition.position[:, PALM_DIM : self.spec.action_dim]

    def forecast_loss(self, label: Forecast, condition: Condition, arrival: Tensor, known: Tensor) -> Tensor:
        """See `ForecastHead.forecast_loss`: distances along the path, above all where they will meet, and the grasp."""
        forecast = self.forecast(condition)
        error = (forecast.path - label.path) * known[..., None]  # (R, K, 3)
        meeting = self.between[arrival.long().clamp(0, KNOTS[-1])]  # (R, K)
        along = (_length(error) / (0.05 + 0.3 * self.ahead_s)).mean(-1)
        distance = along + _length((meeting[..., None] * error).sum(1)) / 0.1
        missing = label.closed - forecast.closed
        grasp = torch.maximum(CLOSED_QUANTILE * missing, (CLOSED_QUANTILE - 1) * missing)
        return distance + grasp.mean(-1)

    def chunk(self, forecast: Forecast, condition: Condition) -> Tensor:
        """See `ForecastHead.chunk`; palm targets are relative to the palm [m].

        The approach begins where the hand will be after the prefix, and when it will be there.
        """
        prefix = self._prefix(condition)
        start = executed(self._here(condition), prefix.actions, prefix.length, self.reach)
        path = delayed(self.path(forecast), prefix.length)
        n_steps = self.spec.horizon - self.spec.latency_frames
        return continued(prefix, self.moves(path, forecast.closed, start, n_steps))

    def path(self, forecast: Forecast) -> Tensor:
        """See `ForecastHead.path`."""
        return self.between @ forecast.path

    def moves(self, path: Tensor, closed: Tensor, start: Tensor, n_steps: int) -> Tensor:
        """See `ForecastHead.moves`."""
        joints, origin = start[:, PALM_DIM:], start[:, None, :PALM_DIM]
        path = path - origin - self.seat_m  # (B, F + 1, 3)
        palm = self._approach(path, (closed - joints).abs().amax(-1))
        pressed = closed + self.squeeze_rad
        fingers = close_in_time(joints, pressed, first_contact(palm, path), n_steps, self.reach)
        return torch.cat([palm[:, 1 : n_steps + 1] + origin, fingers], dim=-1)


def delayed(path: Tensor, frames: Tensor) -> Tensor:
    """Return paths (B, F + 1, 3) from ``frames`` (B,) later on; their ends are repeated."""
    index = torch.arange(path.shape[1], device=path.device) + frames[:, None]  # (B, F + 1)
    return path.gather(1, index.clamp_max(path.shape[1] - 1)[..., None].expand_as(path))


def continued(prefix: Prefix, moves: Tensor) -> Tensor:
    """Return the executed part of prefixes of up to D actions and then moves (B, n, A), ``(B, D + n, A)``."""
    place = torch.arange(prefix.actions.shape[1] + moves.shape[1], device=moves.device) - prefix.length[:, None]
    later = moves.gather(1, place.clamp(0, moves.shape[1] - 1)[..., None].expand(-1, -1, moves.shape[2]))
    chunk = torch.cat([prefix.actions, moves], dim=1)
    return torch.where((place < 0)[..., None], chunk, later)


def interpolation(knots: tuple[int, ...]) -> Tensor:
    """Return (F + 1, K) weights of the knots at each frame from 0 to the last knot: the natural cubic spline."""
    at, n = torch.tensor(knots, dtype=torch.float64), len(knots)
    gap, identity = at.diff(), torch.eye(n, dtype=torch.float64)
    slopes = identity.diff(dim=0) / gap[:, None]  # (K - 1, K)
    system, right = identity.clone(), torch.zeros(n, n, dtype=torch.float64)
    for k in range(1, n - 1):  # the second derivative is continuous at inner knots, and zero at both ends
        system[k, k - 1 : k + 2] = torch.stack([gap[k - 1], 2 * (gap[k - 1] + gap[k]), gap[k]])
        right[k] = 6 * (slopes[k] - slopes[k - 1])
    second = torch.linalg.solve(system, right)  # (K, K)
    frames = torch.arange(knots[-1] + 1, dtype=torch.float64)
    left = (torch.searchsorted(at, frames, right=True) - 1).clamp_max(n - 2)
    b = ((frames - at[left]) / gap[left])[:, None]
    a, square = 1 - b, gap[left][:, None].square() / 6
    curve = square * ((a**3 - a) * second[left] + (b**3 - b) * second[left + 1])
    return (a * identity[left] + b * identity[left + 1] + curve).float()


def _length(x: Tensor) -> Tensor:
    """Return the lengths of vectors ``(..., 3)``, differentiable at zero."""
    return x.square().sum(-1).add(1e-8).sqrt()


def _track_of(condition: Condition) -> Track:
    if condition.track is None:
        raise ValueError("head 'intercept' needs a backbone that locates the target, such as 'eye'.")
    return condition.track
