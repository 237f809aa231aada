"""The track: motion models through sightings, of which those of black pictures and unsure ones hardly count."""

from __future__ import annotations

import math

import pytest
import torch
from lerobot_policy_tracker.backbones.eye import EyeBackbone
from lerobot_policy_tracker.decisions import Decisions
from lerobot_policy_tracker.eye import N_SIGHTING, UNSEEN_SCALE
from lerobot_policy_tracker.fitting import fit_lines_of_sight
from lerobot_policy_tracker.frames import EncodedFrames
from lerobot_policy_tracker.motion_models import GRAVITY_M_S2, MODELS, RATES_RAD_S, RESTING_HEIGHT_M, RESTITUTION
from lerobot_policy_tracker.track import Track

AGE_S = torch.arange(11, -1, -1) * 0.05
POSITION, VELOCITY = torch.tensor([0.4, 0.1, -0.1]), torch.tensor([-0.3, 0.5, 0.1])
FALLING = (0.0, 0.0, -GRAVITY_M_S2)
LINE, FALLS = 1, [model.falls for model in MODELS].index(True) + 2
RELEASES_S = [model.released_s for model in MODELS]
CAMERAS = torch.zeros(1, 12, 1, 3)
ON_THE_FLOOR = torch.tensor([-10.0])


def path(turn: tuple[float, ...] = (0.0, 0.0, 0.0), age_s: torch.Tensor = AGE_S) -> torch.Tensor:
    """Return the points of a parabola, ``(1, W, 3)``."""
    return (POSITION - age_s[:, None] * VELOCITY + age_s.square()[:, None] * torch.tensor(turn) / 2)[None]


def fitted(points: torch.Tensor, age_s: torch.Tensor = AGE_S, error_m: float = 0.001) -> Track:
    """Return the track of points ``(1, W, 3)`` that are all seen equally well from the origin."""
    coefficients, evidence = fit_lines_of_sight(points, points, torch.full((*points.shape[:2], 2), error_m), age_s)
    return Track(coefficients.float(), evidence.float(), torch.zeros(1, N_SIGHTING), ON_THE_FLOOR)


def seen_by(sightings: torch.Tensor, n_padding: int = 0) -> Track:
    """Return the track of a hand at the origin with sightings ``(W, N_SIGHTING)``, the first of which are padding."""
    n = len(sightings)
    keep, nothing = torch.arange(n)[None] >= n_padding, torch.zeros(1, n, 1)
    frames = EncodedFrames(nothing, nothing, torch.zeros(1, n, 18), keep, keep, sightings[None, :, None], [""])
    return Track.of(frames, Decisions.among(keep, [range(n)], AGE_S), CAMERAS)


def sightings(points: torch.Tensor) -> torch.Tensor:
    """Return sure sightings ``(W, N_SIGHTING)`` of points ``(W, 3)``."""
    return torch.cat([points, torch.zeros(len(points), 3), torch.full((len(points), 2), -5.0)], dim=-1)


def test_points_of_a_line_give_where_it_ends_and_how_fast_it_is_followed():
    line = fitted(path()).coefficients[0, LINE]
    torch.testing.assert_close(line[:, 0], POSITION, rtol=0, atol=2e-3)
    torch.testing.assert_close(line[:, 1], VELOCITY, rtol=0.05, atol=5e-3)


def test_what_padding_holds_does_not_move_the_line():
    seen = sightings(path()[0])
    elsewhere = seen.clone()
    elsewhere[:4, :3] = torch.tensor([2.0, -2.0, 2.0])
    torch.testing.assert_close(seen_by(elsewhere, 4).coefficients, seen_by(seen, 4).coefficients)
    assert (seen_by(elsewhere).coefficients[0, LINE] - seen_by(seen).coefficients[0, LINE]).abs().max() > 0.1


def test_what_a_black_picture_shows_does_not_move_the_line():
    seen = sightings(path()[0])
    expected = seen_by(seen).coefficients[0, LINE]
    seen[-2:, :3] = torch.tensor([2.0, -2.0, 2.0])
    seen[-2:, 6:] = UNSEEN_SCALE
    torch.testing.assert_close(seen_by(seen).coefficients[0, LINE, :, :2], expected[:, :2], rtol=0.1, atol=0.01)


def test_an_eye_sees_nothing_in_a_black_picture():
    torch.manual_seed(0)
    images = torch.rand(2, 3, 32, 32)
    images[1] = 0.0
    scales = EyeBackbone(16, channels=8, fovea=12, embedding=4).look(images)[:, N_SIGHTING - 2 : N_SIGHTING]
    assert (scales[1] == UNSEEN_SCALE).all()
    assert (scales[0] < 2.0).all()


def test_a_model_that_falls_knows_a_throw_from_three_frames():
    age_s = torch.tensor([0.1, 0.05, 0.0])
    track = fitted(path(FALLING, age_s), age_s)
    torch.testing.assert_close(track.coefficients[0, FALLS, :, 1], VELOCITY, rtol=0, atol=0.03)
    assert track.evidence[0, FALLS] > track.evidence[0, LINE] + 3, "no straight line"


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), FALLING, (0.0, 1.5, -1.0)], ids=["straight", "thrown", "turning"])
def test_the_likeliest_model_leads_to_where_the_target_will_be(turn: tuple[float, ...]):
    track, ahead_s = fitted(path(turn)), torch.tensor([0.0, 0.3])
    led = track.along(ahead_s)[0, track.evidence[0].argmax()]
    expected = POSITION + ahead_s[:, None] * VELOCITY + ahead_s.square()[:, None] * torch.tensor(turn) / 2
    torch.testing.assert_close(led, expected, rtol=0, atol=0.03)


def test_an_oscillator_knows_where_a_pendulum_will_be_half_a_period_later_and_a_parabola_does_not():
    rate = RATES_RAD_S[5]
    time_s, ahead_s = torch.arange(-24, 1) * 0.05, torch.tensor([math.pi / rate])

    def swing(t: torch.Tensor) -> torch.Tensor:
        angle = (rate * t + 0.7).sin() * 0.4
        return 0.5 * torch.stack([torch.ones_like(t), angle.sin(), -angle.cos()], dim=-1)

    track = fitted(swing(time_s)[None], -time_s)
    off_m = (track.along(ahead_s)[0, :, 0] - swing(ahead_s)).norm(dim=-1)
    likeliest = track.evidence[0].argmax()
    assert MODELS[likeliest].rate_rad_s == rate
    assert off_m[likeliest] < 0.02
    assert off_m[2] > 0.3


def test_a_throw_is_known_by_when_it_was_released():
    released_s = 0.25
    flown_s = (released_s - AGE_S).clamp_min(0.0)[:, None]
    points = POSITION + flown_s * VELOCITY + flown_s.square() * torch.tensor(FALLING) / 2
    track = fitted(points[None])
    likeliest = int(track.evidence[0].argmax())
    assert RELEASES_S[likeliest] == released_s
    later_s = released_s + 0.3
    expected = POSITION + later_s * VELOCITY + later_s**2 * torch.tensor(FALLING) / 2
    torch.testing.assert_close(track.along(torch.tensor([0.3]))[0, likeliest, 0], expected, rtol=0, atol=0.02)


def test_what_falls_bounces_off_the_floor():
    track = fitted(path(FALLING))
    floor_m = POSITION[2:] - 0.3 - RESTING_HEIGHT_M
    track = Track(track.coefficients, track.evidence, track.sighting, floor_m)
    up_m_s = VELOCITY[2].item()
    hit_s = (up_m_s + math.sqrt(up_m_s**2 + 2 * GRAVITY_M_S2 * 0.3)) / GRAVITY_M_S2
    top_s = RESTITUTION * (GRAVITY_M_S2 * hit_s - up_m_s) / GRAVITY_M_S2
    led = track.along(torch.tensor([hit_s, hit_s + top_s]))[0, FALLS, :, 2] - POSITION[2]
    torch.testing.assert_close(led, torch.tensor([-0.3, -0.3 + GRAVITY_M_S2 * top_s**2 / 2]), rtol=0, atol=0.02)
    torch.testing.assert_close(
        track.along(torch.tensor([hit_s]))[0, LINE], fitted(path(FALLING)).along(torch.tensor([hit_s]))[0, LINE]
    )


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25])
def test_lines_of_sight_from_a_moving_camera_cross_where_the_target_is_however_wrong_the_distances(factor: float):
    age_s = torch.arange(15, -1, -1) * 0.05
    camera = (0.4 - age_s).clamp_min(0.0)[:, None] * torch.tensor([0.1, 0.4, -0.3])  # bearings of a steady one say less
    target = path(FALLING, age_s)
    rays = target - camera
    errors_m = factor * rays.norm(dim=-1, keepdim=True) * torch.tensor([0.003, 0.2])
    coefficients, _ = fit_lines_of_sight(camera + factor * rays, factor * rays, errors_m, age_s)
    off_m = (coefficients[0, FALLS, :, 0] - POSITION).norm()
    seen_off_m = (factor - 1) * rays[0, -1].norm()
    assert off_m < (0.05 if factor != 1.0 else 2e-3)
    assert abs(seen_off_m) > 1.5 * off_m or factor == 1.0


def test_unseen_frames_do_not_count():
    points = path(FALLING)
    errors_m = torch.full((1, 12, 2), 0.01)
    errors_m[:, :6] = torch.inf
    expected = fit_lines_of_sight(points, points, errors_m, AGE_S)
    moved = points.clone()
    moved[:, :6] += 10.0
    for got, same in zip(fit_lines_of_sight(moved, moved, errors_m, AGE_S), expected, strict=True):
        torch.testing.assert_close(got, same)


def test_evidence_is_the_likelihood_of_the_sightings():
    """Compared with a dense Gaussian of all that is seen, with coefficients and factor integrated out."""
    torch.manual_seed(0)
    points = path() + 0.02 * torch.randn(1, 12, 3)
    rays, errors_m = points - torch.tensor([0.0, 0.3, 0.0]), torch.tensor([0.01, 0.04]).expand(1, 12, 2)
    _, evidence = fit_lines_of_sight(points, rays, errors_m, AGE_S)
    dense = [_dense_likelihood(model, points[0].double(), rays[0].double()) for model in MODELS]
    torch.testing.assert_close(evidence[0] - evidence[0, 0], torch.stack(dense) - dense[0], rtol=1e-3, atol=1e-3)


def _dense_likelihood(model, points: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    age_s = AGE_S.double()
    basis, scales = model.basis(-age_s), points.new_tensor(model.scales)
    shared = torch.kron((basis * scales.square()) @ basis.T, torch.eye(3, dtype=points.dtype))
    camera = points - rays
    scaled = (basis @ model.expected(points).T - camera).flatten()
    covariance = shared + 0.15**2 * scaled[:, None] * scaled
    strayed = (model.stray_m_s2 * age_s.square() / 2).square()
    for k, ray in enumerate(rays):
        along = torch.outer(ray, ray) / ray.square().sum()
        errors = (0.01**2 + strayed[k]) * (torch.eye(3, dtype=points.dtype) - along) + (0.04**2 + strayed[k]) * along
        covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += errors
    off = (points - basis @ model.expected(points).T).flatten()
    return -(off @ torch.linalg.solve(covariance, off) + torch.linalg.slogdet(covariance)[1]) / 2


def test_half_precision_of_the_network_does_not_move_a_fit():
    whole = seen_by(sightings(path()[0]))
    with torch.autocast("cpu", torch.bfloat16):
        mixed = seen_by(sightings(path()[0]))
    torch.testing.assert_close(mixed.coefficients, whole.coefficients, rtol=0, atol=0)
