"""The track: motion models through sightings, of which those of black pictures and unsure ones hardly count."""

from __future__ import annotations

import pytest
import torch
from lerobot_policy_obact.backbones.eye import N_SIGHTING, UNSEEN_SCALE, EyeBackbone
from lerobot_policy_obact.decisions import Decisions
from lerobot_policy_obact.frames import EncodedFrames
from lerobot_policy_obact.motion_models import GRAVITY_M_S2, MODELS, fit_places
from lerobot_policy_obact.track import Track, sighting_error
from lerobot_policy_obact.triangulation import fit_lines_of_sight

AGE_S = torch.tensor([0.2, 0.15, 0.1, 0.05, 0.0])
POSITION, VELOCITY = torch.tensor([0.4, 0.1, -0.1]), torch.tensor([-0.3, 0.5, 0.1])
POINTS = POSITION - AGE_S[:, None] * VELOCITY  # (5, 3)


def sightings(points: torch.Tensor, across: float = -5.0, along: float = -5.0) -> torch.Tensor:
    """Return sightings ``(5, N_SIGHTING)`` of points ``(5, 3)`` with scales of their errors."""
    scales = torch.tensor([across, along]).expand(5, 2)
    return torch.cat([points, torch.zeros(5, 3), scales], dim=-1)


def fitted(seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    weights = sighting_error(seen).square().reciprocal()
    motion, _ = fit_places(seen[None, :, :3], weights[None], AGE_S)
    return motion[0, 0, 0], motion[0, 0, 1]


def path(turn: torch.Tensor, n: int = 12) -> tuple[torch.Tensor, torch.Tensor]:
    """Return n points of a parabola, ``(1, n, 3)``, and their ages."""
    age_s = torch.arange(n - 1, -1, -1) * 0.05
    return (POSITION - age_s[:, None] * VELOCITY + age_s.square()[:, None] * turn / 2)[None], age_s


def test_points_of_a_line_give_where_it_ends_and_how_fast_it_is_followed():
    offset, velocity = fitted(sightings(POINTS))
    torch.testing.assert_close(offset, POSITION, rtol=0, atol=1e-3)
    torch.testing.assert_close(velocity, VELOCITY, rtol=0.1, atol=1e-3)  # a prior holds it near zero


def test_what_a_black_picture_shows_does_not_move_the_line():
    seen = sightings(POINTS)
    seen[-2:, :3] = torch.tensor([2.0, -2.0, 2.0])
    seen[-2:, 6:] = UNSEEN_SCALE
    offset, velocity = fitted(seen)
    torch.testing.assert_close(offset, POSITION, rtol=0, atol=5e-3)
    torch.testing.assert_close(velocity, VELOCITY, rtol=0.1, atol=1e-2)


def test_an_error_across_the_line_of_sight_counts_as_one_along_it_does():
    sure = sighting_error(sightings(POINTS))
    torch.testing.assert_close(
        sighting_error(sightings(POINTS, across=-1.0)), sighting_error(sightings(POINTS, -5.0, -1.0)), rtol=0.02, atol=0
    )
    assert (sighting_error(sightings(POINTS, across=-1.0)) > 5 * sure).all()


def test_an_eye_sees_nothing_in_a_black_picture():
    torch.manual_seed(0)
    images = torch.rand(2, 3, 32, 32)
    images[1] = 0.0
    scales = EyeBackbone(16, channels=8, fovea=12, embedding=4).look(images)[:, N_SIGHTING - 2 : N_SIGHTING]
    assert (scales[1] == UNSEEN_SCALE).all()
    assert (scales[0] < 2.0).all()


def test_a_parabola_tells_how_the_target_turns():
    turn = torch.tensor([0.5, -2.0, -9.8])
    points, age_s = path(turn)
    position, velocity, acceleration = fit_places(points, torch.full((1, 12), 1e6), age_s)[0][0, 1]
    torch.testing.assert_close(position, POSITION, rtol=0, atol=1e-3)
    torch.testing.assert_close(velocity, VELOCITY, rtol=0, atol=1e-2)
    torch.testing.assert_close(acceleration, turn, rtol=0.01, atol=0.05)


def test_a_model_that_falls_knows_a_throw_from_three_frames():
    points, age_s = path(torch.tensor([0.0, 0.0, -GRAVITY_M_S2]), n=3)
    motion, misfit = fit_places(points, torch.full((1, 3), 1e6), age_s)
    falls = [model.falls for model in MODELS].index(True)
    torch.testing.assert_close(motion[0, falls, 1], VELOCITY, rtol=0, atol=1e-2)
    torch.testing.assert_close(motion[0, falls, 2], torch.tensor([0.0, 0.0, -GRAVITY_M_S2]))
    assert misfit[0, 0] > 20 * misfit[0, falls], "no straight line"


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.0, 0.0, -GRAVITY_M_S2)], ids=["straight", "thrown"])
def test_the_model_that_fits_leads_to_where_the_target_will_be(turn: tuple[float, float, float]):
    points, age_s = path(torch.tensor(turn))
    motion, misfit = fit_places(points, torch.full((1, 12), 1e6), age_s)
    track = Track(motion, misfit, torch.zeros(1, N_SIGHTING))
    ahead_s = torch.tensor([0.0, 0.5])
    led = track.along(ahead_s)[0, misfit[0].argmin()]
    expected = POSITION + ahead_s[:, None] * VELOCITY + ahead_s.square()[:, None] * torch.tensor(turn) / 2
    torch.testing.assert_close(led, expected, rtol=0, atol=0.02)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25])
def test_lines_of_sight_from_a_moving_camera_cross_where_the_target_is_however_wrong_the_distances(factor: float):
    age_s = torch.arange(15, -1, -1) * 0.05
    camera = (0.4 - age_s).clamp_min(0.0)[:, None] * torch.tensor([0.1, 0.4, -0.3])  # bearings of a steady one say less
    target, _ = path(torch.tensor([0.0, 0.0, -GRAVITY_M_S2]), n=16)
    rays = target - camera
    errors_m = rays.norm(dim=-1, keepdim=True) * torch.tensor([0.003, 0.2])
    points = camera + factor * rays
    motion, misfit = fit_lines_of_sight(points, factor * rays, 1 / (factor * errors_m), age_s)
    falls = [model.falls for model in MODELS].index(True)
    places, _ = fit_places(points, errors_m.square().sum(-1).reciprocal(), age_s)
    assert motion.shape == places.shape
    assert misfit.shape == (1, len(MODELS))
    off_m, places_off_m = ((fit[0, falls, 0] - POSITION).norm() for fit in (motion, places))
    assert off_m < (0.04 if factor != 1.0 else 1e-3)
    assert places_off_m > 2 * off_m


def test_unseen_frames_do_not_count_in_lines_of_sight():
    points, age_s = path(torch.tensor([0.0, 0.0, -GRAVITY_M_S2]))
    trust = torch.tensor([100.0, 10.0]).expand(1, 12, 2).clone()
    trust[:, :6] = 0.0
    all_but_six = fit_lines_of_sight(points, points, trust, age_s)
    points = points.clone()
    points[:, :6] += 10.0
    for got, expected in zip(fit_lines_of_sight(points, points, trust, age_s), all_but_six, strict=True):
        torch.testing.assert_close(got, expected)


def test_half_precision_of_the_network_does_not_move_a_fit():
    yes, nothing = torch.ones(1, 5, dtype=torch.bool), torch.zeros(1, 5, 1)
    frames = EncodedFrames(nothing, nothing, torch.zeros(1, 5, 18), yes, yes, sightings(POINTS)[None], [""])
    decisions = Decisions.among(yes, [range(5)], AGE_S)
    whole = Track.of(frames, decisions, torch.zeros(1, 18), torch.zeros(3))
    with torch.autocast("cpu", torch.bfloat16):
        mixed = Track.of(frames, decisions, torch.zeros(1, 18), torch.zeros(3))
    torch.testing.assert_close(mixed.motion, whole.motion, rtol=0, atol=0)
