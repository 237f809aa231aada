"""Motion models fitted to lines of sight and distances from a hand that moves.

A small picture tells the direction to half a centimetre and the distance to several. And the errors of distances
are not independent: a large ball far away looks like a small one near by, in every picture of an episode. On what a
policy sees, the logarithmic errors of consecutive frames have a correlation of 0.8, and 0.5 over half a second. So
errors along and across the line of sight are weighted apart, and one factor u of all distances is estimated with the
coefficients x of each model, whose path is ``B(t) x``. With ``c_i`` where the camera was, ``r_i`` from there to the
sighting, and y = u (x - x0), what is seen is linear in what is not known::

    minimise over y, u   sum_i |r_i - B(-age_i) y - u (B(-age_i) x0 - c_i)|_i^2 + |y / X|^2 + |(u - 1) / F|^2

``|.|_i`` is in units of what is expected of sighting i along and across ``r_i``: its error, and how far paths stray
from the model in ``age_i``. Lines of sight from a camera that moves cross where the target is (triangulation), and what
falls tells its distance by how fast. A model's evidence is the likelihood of all sightings under it (Bishop, Pattern
Recognition and Machine Learning, section 3.5), so a model is not preferred for having more coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .motion_models import MODELS, MotionModel

TYPICAL_FACTOR = 0.15
"""F, the standard deviation of an episode's common factor of distances."""
LEAST_FACTOR = 0.5


def fit_lines_of_sight(points: Tensor, rays: Tensor, errors_m: Tensor, age_s: Tensor) -> tuple[Tensor, Tensor]:
    """Fit `MODELS` to sightings, in double precision.

    Args:
        points: where targets were seen, shape ``(R, W, 3)`` [m].
        rays: from the camera to there, shape ``(R, W, 3)`` [m].
        errors_m: expected across and along the rays, shape ``(R, W, 2)`` [m]; infinite for what was not seen.
        age_s: of the sightings [s], shape ``(W,)``.

    Returns:
        Coefficients of the models, shape ``(R, M, 3, N_COEFFICIENTS)``, and their logarithmic evidence ``(R, M)``.
    """
    points, rays, errors_m, age_s = (x.to(_exact_device(x), torch.float64) for x in (points, rays, errors_m, age_s))
    seen = _Sightings(points, rays, lines_of_sight(rays), errors_m.square(), age_s)
    fits = [_fit(model, seen) for model in MODELS]
    coefficients, evidence = (torch.stack(parts, dim=1) for parts in zip(*fits, strict=True))
    return coefficients, evidence


def _exact_device(x: Tensor) -> torch.device:
    """Return where double precision is to be had: Apple's GPUs have none."""
    return torch.device("cpu") if x.device.type == "mps" else x.device


@dataclass(frozen=True)
class _Sightings:
    """See `fit_lines_of_sight`; ``along`` (R, W, 3, 3) projects onto the rays, and errors are squared."""

    points: Tensor
    rays: Tensor
    along: Tensor
    errors_m2: Tensor
    age_s: Tensor


def _fit(model: MotionModel, seen: _Sightings) -> tuple[Tensor, Tensor]:
    strayed = model.stray_m_s2 * seen.age_s.square() / 2
    weights = (seen.errors_m2 + strayed.square()[:, None]).reciprocal()  # (R, W, 2)
    metric = measure(seen.along, weights)  # (R, W, 3, 3)
    basis = model.basis(-seen.age_s)  # (W, B)
    expected, scales = model.expected(seen.points), basis.new_tensor(model.scales)
    basis, known = basis * scales, basis @ expected.T
    left, shift = seen.points - known, TYPICAL_FACTOR * (known - seen.points + seen.rays)  # (R, W, 3)
    weighed, pulled = ((metric @ x[..., None])[..., 0] for x in (left, shift))

    root = torch.linalg.cholesky(_normal(metric, basis, shift, pulled))
    right = torch.einsum("rwi,wk->rik", weighed, basis).flatten(1)
    right = torch.cat([right, (shift * weighed).sum((1, 2))[:, None]], dim=1)
    solution = torch.cholesky_solve(right[..., None], root)[..., 0]
    squares = (left * weighed).sum((1, 2)) - (right * solution).sum(1)
    sharpness = torch.where(weights > 0, weights, 1.0).log() @ weights.new_tensor([1.0, 0.5])  # (R, W)
    evidence = sharpness.sum(1) - squares / 2 - root.diagonal(dim1=1, dim2=2).log().sum(1)
    factor = (1 + TYPICAL_FACTOR * solution[:, -1:, None]).clamp_min(LEAST_FACTOR)
    return solution[:, :-1].unflatten(1, (3, -1)) * scales / factor + expected, evidence


def _normal(metric: Tensor, basis: Tensor, shift: Tensor, pulled: Tensor) -> Tensor:
    """Return the normal equations' matrix, ``(R, 3 B + 1, 3 B + 1)``; its unknowns are in units of what is expected.

    Args:
        metric: see `measure`.
        basis: of the path, shape ``(W, B)``.
        shift: by which the factor moves each sighting, shape ``(R, W, 3)``.
        pulled: the metric times that.
    """
    squared = (basis[:, :, None] * basis[:, None]).flatten(1)  # (W, B B)
    of_path = (metric.flatten(2).mT @ squared).unflatten(1, (3, 3)).unflatten(3, (basis.shape[1], -1))
    of_path = of_path.transpose(2, 3).flatten(3).flatten(1, 2)  # (R, 3, 3, B, B) to (R, 3 B, 3 B)
    of_both = torch.einsum("rwi,wk->rik", pulled, basis).flatten(1)[..., None]
    of_factor = (shift * pulled).sum((1, 2))[:, None, None]
    normal = torch.cat([torch.cat([of_path, of_both], -1), torch.cat([of_both.mT, of_factor], -1)], 1)
    return normal + torch.eye(normal.shape[1], dtype=normal.dtype, device=normal.device)


def lines_of_sight(rays: Tensor) -> Tensor:
    """Return the projections onto rays ``(..., 3)``, ``(..., 3, 3)``."""
    toward = rays / rays.norm(dim=-1, keepdim=True).clamp_min(1e-3)
    return toward[..., :, None] * toward[..., None, :]


def measure(along: Tensor, weights: Tensor) -> Tensor:
    """Return the matrices of squared errors in units of what is expected across and along rays, ``(..., 3, 3)``.

    Args:
        along: projections onto the rays, shape ``(..., 3, 3)``.
        weights: squared units across and along them, inverted, shape ``(..., 2)``.
    """
    across = torch.eye(3, dtype=along.dtype, device=along.device) - along
    return weights[..., 0, None, None] * across + weights[..., 1, None, None] * along
