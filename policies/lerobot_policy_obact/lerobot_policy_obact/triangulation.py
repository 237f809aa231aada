"""Motion models fitted to lines of sight and distances from a hand that moves.

A small picture tells the direction to half a centimetre and the distance to several. And the errors of distances
are not independent: a large ball far away looks like a small one near by, in every picture of an episode. On what a
policy sees, the logarithmic errors of consecutive frames have a correlation of 0.8, and 0.5 over half a second. So
errors along and across the line of sight are weighted apart, and one factor 1 + f of all distances is estimated with
the motion::

    minimise over p, v, c, f   sum_i exp(-age_i / A) |q_i + f r_i - p + v age_i - c age_i^2 / 2|_i^2
                               + |v / V|^2 + |(c - g) / C|^2 + (f / F)^2

with ``r_i`` from the camera to the sighting ``q_i`` and ``|.|_i`` in units of the errors expected of sighting i along
and across ``r_i``. Lines of sight from a hand that turns cross where the target is (triangulation).
"""

from __future__ import annotations

import torch
from torch import Tensor

from .motion_models import MODELS, misfit, powers, priors, remembered

TYPICAL_FACTOR = 0.15
"""F, the standard deviation of an episode's common factor of distances."""


def fit_lines_of_sight(points: Tensor, rays: Tensor, trust: Tensor, age_s: Tensor) -> tuple[Tensor, Tensor]:
    """Fit `MODELS` to sightings; see `fit_places` for what is returned.

    Args:
        points: where targets were seen, shape ``(R, W, 3)`` [m].
        rays: from the camera to there, shape ``(R, W, 3)`` [m].
        trust: inverses of the errors across and along the rays, shape ``(R, W, 2)`` [1/m]; 0 for what was not seen.
        age_s: of the sightings [s], shape ``(W,)``.
    """
    fade = remembered(age_s)
    measures = _measures(rays, trust)  # (R, W, 3, 3)
    by_motion = (powers(age_s)[:, None, :, None] * measures[:, :, :, None]).flatten(-2)  # (R, W, 3, 9)
    by_factor = -(trust[..., 1:] * rays)[..., None]
    design = torch.cat([by_motion, by_factor], dim=-1)  # (R, W, 3, 10)
    seen = (measures @ points[..., None])[..., 0]  # (R, W, 3)
    expected, prior = _priors(points)
    normal = torch.einsum("mw,rwij->rmij", fade, design.mT @ design) + prior.diag_embed()
    right = torch.einsum("mw,rwi->rmi", fade, (design.mT @ seen[..., None])[..., 0]) + prior * expected
    solution = torch.linalg.solve(normal, right)  # (R, M, 10)
    off = (seen[..., None] - design @ solution.mT[:, None]).square().sum(2)  # (R, W, M)
    squares = torch.einsum("mw,rwm->rm", fade, off)
    return solution[..., :9].unflatten(-1, (3, 3)), misfit(squares, fade, trust[..., 0] > 0)


def _measures(rays: Tensor, trust: Tensor) -> Tensor:
    """Return matrices that turn errors [m] into multiples of what is expected of them, ``(R, W, 3, 3)``."""
    toward = rays / rays.norm(dim=-1, keepdim=True).clamp_min(1e-3)
    along = toward[..., :, None] * toward[..., None, :]
    across = torch.eye(3, device=rays.device) - along
    return trust[..., 0, None, None] * across + trust[..., 1, None, None] * along


def _priors(like: Tensor) -> tuple[Tensor, Tensor]:
    """Return what is expected of a model's ten unknowns, and the inverse squares of differences, ``(M, 10)``."""
    expected, prior = priors(like)
    factor = like.new_full((len(MODELS), 1), TYPICAL_FACTOR**-2)
    of_motion = prior.repeat_interleave(3, dim=-1)
    return torch.cat([expected.flatten(1), torch.zeros_like(factor)], dim=-1), torch.cat([of_motion, factor], dim=-1)
