"""A light correction in every frame of what a slow chunk expected (after A2C2, arXiv 2509.23224).

While a chunk is planned and executed the eye goes on to see. What it sees of the target is compared with the path that
the chunk was planned for, and the hand goes to meet the target on a corrected path::

    minimise over a, b   sum_j |p_j - P(t_j) - a - b t_j|_j^2 + |a / A|^2 + |b / V|^2,    corrected: P(t) + a + b t

P is the path that was expected at time 0, ``p_j`` a sighting at time ``t_j`` after it, and ``|.|_j`` is in units of its
expected errors along and across the line of sight. Only the eye and this system of six equations are computed in a
frame; the fits of motion models, the attention and the head are left to the chunk's own inference.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .fitting import lines_of_sight, measure
from .sightings import Sightings

POSITION_M, SPEED_M_S = 0.03, 0.2
"""A and V: typical errors of an expected path where it begins, and of its velocity."""
CORRELATED = 10.0
"""Errors of consecutive sightings are alike, so each counts as a fraction of one."""


@dataclass(frozen=True)
class Expectation:
    """What ``B`` chunks were planned for.

    Attributes:
        path: where the targets were expected, from the frame of the observation on, in the frame of the state, shape
            ``(B, F + 1, 3)`` [m].
        closed: joint angles that close the hand around the target, shape ``(B, J)`` [rad].
    """

    path: Tensor
    closed: Tensor

    @classmethod
    def concatenate(cls, parts: list[Expectation]) -> Expectation:
        """Put the rows of several together."""
        return cls(torch.cat([part.path for part in parts]), torch.cat([part.closed for part in parts]))

    def rows(self, index: list[int]) -> Expectation:
        """Return the rows at ``index``."""
        return Expectation(self.path[index], self.closed[index])


def corrected_path(expected: Tensor, seen: Sightings, age: Tensor, fps: float) -> Tensor:
    """Return where targets will be from now on, ``(B, F + 1, 3)`` [m].

    Args:
        expected: where they were expected ``age`` frames ago, from then on, shape ``(B, F + 1, 3)``.
        seen: since the greatest age.
        age: frames since then, shape ``(B,)``.
        fps: frames in a second.
    """
    last, n = expected.shape[1] - 1, seen.points.shape[1]
    place = age[:, None] + torch.arange(1 - n, 1, device=expected.device)  # (B, n)
    time_s = place.clamp_min(0) / fps
    then = _at(expected, place.clamp(0, last))
    missed = seen.points - then[:, :, None]  # (B, n, C', 3)
    weights = (seen.errors_m.square() * CORRELATED).reciprocal() * (place > 0)[..., None, None]
    metric = measure(lines_of_sight(seen.rays), weights)  # (B, n, C', 3, 3)
    offset, drift = _least_squares(metric.sum(2), (metric @ missed[..., None])[..., 0].sum(2), time_s)
    ahead = age[:, None] + torch.arange(last + 1, device=expected.device)  # (B, F + 1)
    return _at(expected, ahead.clamp_max(last)) + offset[:, None] + drift[:, None] * (ahead / fps)[..., None]


def _least_squares(metric: Tensor, weighed: Tensor, time_s: Tensor) -> tuple[Tensor, Tensor]:
    """Return a and b, each ``(B, 3)``, of metrics (B, n, 3, 3), weighed residuals (B, n, 3) and times (B, n)."""
    basis = torch.stack([torch.ones_like(time_s), time_s], dim=-1)  # (B, n, 2)
    normal = torch.einsum("bnk,bnl,bnij->bkilj", basis, basis, metric).flatten(3, 4).flatten(1, 2)
    prior = metric.new_tensor([POSITION_M] * 3 + [SPEED_M_S] * 3).square().reciprocal().diag()
    right = torch.einsum("bnk,bni->bki", basis, weighed).flatten(1)
    offset, drift = torch.linalg.solve(normal + prior, right).split(3, dim=-1)
    return offset, drift


def _at(path: Tensor, place: Tensor) -> Tensor:
    """Return points ``(B, K, 3)`` of paths ``(B, F + 1, 3)`` at frames ``(B, K)``."""
    return path.gather(1, place[..., None].expand(-1, -1, 3))
