"""What must hold of every registered motion, with no line per motion."""

import json

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT, PHYSICS_DT
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS, PrescribedMotion
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene.model import ARENA_HALF_M
from tests.simulation import draw_motion

KINDS = MOTIONS.names()
PRESCRIBED = [name for name, kind in MOTIONS.items() if issubclass(kind, PrescribedMotion)]
SEEDS = range(5)
MAX_ACCELERATION_M_S2 = 30.0
MIN_PATH_M = 0.015
"""Path from the start to the intercept: what the slowest accelerating line covers in its shortest
episode."""


def sampled(kind: str) -> list[EpisodeSpec]:
    """Two episodes of a kind, in a split that may play it."""
    split = "ood_motion" if kind in BENCHMARK.splits["ood_motion"].motions else "val"
    return sample_specs(Recipe(split=split, motions=(kind,)), range(2))


@pytest.mark.parametrize("kind", KINDS)
def test_says_what_it_is(kind: str):
    motion = MOTIONS[kind]
    assert motion.name == kind
    assert motion.category in CATEGORIES
    assert motion.__doc__
    assert len(motion.phrase.split()) >= 2
    assert motion.phrase[0].islower(), "the phrase continues 'the object that is'"
    assert not motion.phrase.endswith(".")


@pytest.mark.parametrize("kind", KINDS)
def test_each_seed_draws_a_motion_whose_parameters_are_finite_json_that_gives_it_back(kind: str):
    for seed in SEEDS:
        motion = draw_motion(kind, seed).motion
        assert motion == draw_motion(kind, seed).motion
        values = json.loads(motion.parameters(), parse_constant=pytest.fail)
        assert MOTIONS[kind](**{name: _as_tuple(value) for name, value in values.items()}) == motion
    assert len({draw_motion(kind, seed).motion.parameters() for seed in SEEDS}) == len(SEEDS)


@pytest.mark.parametrize("kind", PRESCRIBED)
def test_the_velocity_of_a_prescribed_path_never_jumps(kind: str):
    """What drives the target along it would be an impulse, and no prediction could follow."""
    for seed in SEEDS:
        drawn = draw_motion(kind, seed)
        path = drawn.motion.position(np.arange(0.0, drawn.horizon_s, PHYSICS_DT))
        assert np.abs(np.diff(path, n=2, axis=0)).max() / PHYSICS_DT**2 < MAX_ACCELERATION_M_S2


@pytest.mark.parametrize(
    "kind", ["constant", "line_then_arc", "horizontal_circle", "vertical_circle", "helix"]
)
def test_lines_and_circles_have_constant_speed(kind: str):
    for seed in SEEDS:
        drawn = draw_motion(kind, seed)
        path = drawn.motion.position(np.arange(0.0, drawn.horizon_s, PHYSICS_DT))
        step_m = np.linalg.norm(np.diff(path, axis=0), axis=1)
        np.testing.assert_allclose(step_m, step_m[0], rtol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_every_sampled_path_is_finite_inside_the_arena_and_moving(kind: str):
    for spec in sampled(kind):
        assert spec.motion.name == kind
        assert len(spec.target_path_w) == spec.window_frames + spec.length_frames + 1
        _assert_in_arena(spec.target_path_w)
        if isinstance(spec.motion, PrescribedMotion):  # between frames, too
            _assert_in_arena(
                spec.motion.position(np.arange(0.0, spec.horizon_frames * CONTROL_DT, PHYSICS_DT))
            )
        until_met = spec.target_path_w[: spec.intercept_frame + 1]
        path_m = np.linalg.norm(np.diff(until_met, axis=0), axis=1).sum()
        assert path_m > MIN_PATH_M, (
            f"{spec.motion.name} of seed {spec.seed} covers only {path_m:.4f} m"
        )


def _assert_in_arena(path: np.ndarray) -> None:
    assert np.isfinite(path).all()
    assert (np.abs(path[:, :2]) < ARENA_HALF_M).all()
    assert (path[:, 2] > 0.0).all()


def _as_tuple(value):
    return tuple(_as_tuple(v) for v in value) if isinstance(value, list) else value


def test_a_path_of_another_shape_is_refused_by_name(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(MOTIONS["constant"], "position", lambda self, times: np.zeros(len(times)))
    with pytest.raises(ValueError, match=r"'constant' must return positions of shape \(\d+, 3\)"):
        sample_specs(Recipe(motions=("constant",)), [0])
