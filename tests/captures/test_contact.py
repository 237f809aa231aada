"""The physical capture rule: nothing jumps, nothing tunnels, no energy from nowhere, and only a held target counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.captures import CAPTURES, Track
from dynahoi_lerobot.captures.contact import HELD_FRAMES
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.foundation.conventions import CONTROL_DT, FINGERS
from dynahoi_lerobot.motions.straight_line import Constant
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.rollout.loop import play
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_spec, sample_specs
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.world.batch import WorldBatch

RECIPE = Recipe(split="test", capture="contact", image_size=32)
HOME_W = np.array([0.0, 0.0, 1.1])
PALM_BACK_M = -0.059


@pytest.fixture(scope="module")
def constant() -> EpisodeSpec:
    return sample_spec(replace(RECIPE, motions=("constant",)), 0)


def flying(
    spec: EpisodeSpec, speed_m_s: float, kind: str = "ball", seed: int = 0, friction: float = 0.8
) -> EpisodeSpec:
    """The episode with an object that comes straight at the waiting palm and would be at its centre after 0.5 s."""
    motion = Constant(tuple(HOME_W), (-1.0, 0.0, 0.0), 0.5, speed_m_s, 0.0)
    path = motion.position(np.arange(spec.horizon_frames) * CONTROL_DT)
    target = replace(OBJECTS[kind].sample(np.random.default_rng(seed)), friction=friction)
    return replace(spec, motion=motion, target=target, home_pos_w=HOME_W, oracle_path=path, window_frames=2)


def begin(spec: EpisodeSpec) -> WorldBatch:
    batch = WorldBatch(RECIPE, 1, threads=1)
    batch.reset([0], [spec])
    return batch


def energy_j(batch: WorldBatch, spec: EpisodeSpec) -> float:
    """Kinetic and potential energy of the target."""
    linear, angular = batch.target_velocity[0, :3], batch.target_velocity[0, 3:]
    inertia = max(spec.target.inertia)  # an upper bound is enough
    potential = spec.target.mass_kg * 9.81 * (batch.target_pose[0, 2] + spec.home_pos_w[2])
    return 0.5 * spec.target.mass_kg * linear @ linear + 0.5 * inertia * angular @ angular + potential


@pytest.mark.parametrize("kind", ["ball", "egg", "disc", "ring", "bottle", "cube"])
def test_a_target_at_4_m_s_does_not_pass_through_the_palm(constant: EpisodeSpec, kind: str):
    spec = flying(constant, 4.0, kind)
    batch = begin(spec)
    for _ in range(14):
        batch.step(batch.executed)
        assert batch.target_pose[0, 0] - batch.state[0, 0] > PALM_BACK_M, "it would be behind the palm"
    assert batch.target_velocity[0, 0] > -1.0, "the palm has stopped it"


@pytest.mark.parametrize("friction", [0.6, 1.1])
@pytest.mark.parametrize("speed_m_s", [0.5, 2.0, 4.0])
def test_a_still_hand_gives_no_energy(constant: EpisodeSpec, speed_m_s: float, friction: float):
    spec = flying(constant, speed_m_s, friction=friction)
    batch = begin(spec)
    start = energy_j(batch, spec)
    for _ in range(20):
        batch.step(batch.executed)
        assert energy_j(batch, spec) <= start * (1 + 1e-3) + 1e-4
    assert np.isfinite(batch.state).all()


def test_the_first_touch_lets_go_without_a_jump(constant: EpisodeSpec):
    """Up to the touch the target is on its path; in the frame of the touch its velocity changes by what pushes it."""
    spec = flying(constant, 0.5)
    batch = begin(spec)
    while not batch.contacts.by_hand[0]:
        frame = batch.frame[0]
        np.testing.assert_allclose(batch.target_pose[0, :3], spec.oracle_path[frame] - HOME_W, atol=1e-9)
        before = batch.target_pose[0, :3].copy()
        batch.step(batch.executed)
    assert np.linalg.norm(batch.target_pose[0, :3] - before) < 0.5 * CONTROL_DT + 0.005
    assert batch.contacts.palm_force_n[0] > 0
    for _ in range(10):
        batch.step(batch.executed)
    assert batch.target_pose[0, 2] < -0.5, "nothing carries it any more"


def test_an_untouched_target_follows_its_path(constant: EpisodeSpec):
    batch = begin(constant)
    for _ in range(12):
        batch.step(batch.executed)
    np.testing.assert_allclose(batch.target_pose[0, :3], constant.oracle_path[12] - constant.home_pos_w, atol=1e-9)
    assert not batch.contacts.by_hand.any()
    assert not batch.contacts.others.any()


def test_a_touched_pendulum_loses_its_string():
    spec = sample_spec(replace(RECIPE, motions=("planar",)), 1)
    episode = caught([spec])[0]
    assert episode.stage == "held"
    assert np.linalg.norm(episode.target_pose[-1, :3] - episode.state[-1, :3]) < 0.05


def caught(specs: list[EpisodeSpec], size: int = 8, threads: int = 1) -> list:
    batch = WorldBatch(RECIPE, size, threads)
    jobs = (Job.evaluation(i, spec) for i, spec in enumerate(specs))
    return [episode for _, episode in sorted(play(batch, EXPERTS["match"](), jobs), key=lambda pair: pair[0].index)]


@pytest.fixture(scope="module")
def every_kind() -> list[EpisodeSpec]:
    return sample_specs(RECIPE, range(22))


def test_the_expert_holds_nearly_everything_at_its_first_attempt(every_kind: list[EpisodeSpec]):
    episodes = caught(every_kind)
    assert sum(episode.success for episode in episodes) >= 21
    for episode in episodes:
        step = np.abs(np.diff(episode.action[:, :3], axis=0)).max()
        assert step <= 0.1 + 1e-6, "2 m/s along each axis"


def test_the_expert_moves_alike_in_any_batch(every_kind: list[EpisodeSpec]):
    short = every_kind[::5]
    one, many = caught(short, 1), caught(short, 4, threads=2)
    for a, b in zip(one, many, strict=True):
        np.testing.assert_array_equal(a.state, b.state)
        np.testing.assert_array_equal(a.target_pose, b.target_pose)
        np.testing.assert_array_equal(a.touch, b.touch)


def test_a_hand_that_stays_open_holds_nothing(every_kind: list[EpisodeSpec]):
    batch = WorldBatch(RECIPE, 8, 1)
    jobs = (Job.evaluation(i, spec) for i, spec in enumerate(every_kind[:8]))
    assert not any(episode.success for _, episode in play(batch, EXPERTS["hold"](), jobs))


# -- the verdict ---------------------------------------------------------------------------------------------------

TOUCHING = (*FINGERS, "palm", "others")


def track(frames: int = 20, speed_m_s: float = 0.2, **touching: int) -> Track:
    """A hand on its way in which the named things touch the target during the first so many frames."""
    touch = np.zeros((frames, len(TOUCHING)))
    for name, until in touching.items():
        touch[:until, TOUCHING.index(name)] = 1.0
    contacts = TargetContacts(touch[:, : len(FINGERS)], touch[:, -2], touch[:, -1])
    palm = np.arange(frames)[:, None] * [0.0, 0.0, speed_m_s * CONTROL_DT]
    return Track(
        np.zeros((frames, 15)), np.zeros(15), np.zeros(15), np.ones(frames, bool), contacts, np.zeros(frames), palm
    )


@pytest.mark.parametrize(
    ("played", "stage"),
    [
        (track(thumb=20, index=20), "held"),
        (track(palm=20, little=20), "held"),
        (track(thumb=20, palm=20), "held"),
        (track(thumb=HELD_FRAMES, index=20), "held"),
        (track(thumb=HELD_FRAMES - 1, index=20), "slipped"),
        (track(thumb=2, index=20), "enclosed"),
        (track(index=20, ring=20), "touched"),
        (track(palm=20), "touched"),
        (track(others=20), "missed"),
        (track(thumb=20, index=20, others=20), "touched"),
        (track(thumb=20, index=20, others=11), "slipped"),
        (track(thumb=20, index=20, speed_m_s=0.05), "slipped"),
        (replace(track(thumb=20, index=20), palm_distance=np.full(20, 0.051)), "touched"),
    ],
)
def test_stages(played: Track, stage: str):
    rule = CAPTURES["contact"]()
    assert rule.stage(played) == stage
    assert rule.success(played) == (stage == "held")
    by_frame = [rule.success(played.first(frames)) for frames in range(1, 21)]
    assert rule.succeeded(played).tolist() == by_frame
    assert by_frame == sorted(by_frame), "a success stays one"


def test_a_catch_succeeds_in_the_frame_that_completes_the_hold():
    assert CAPTURES["contact"]().succeeded(track(thumb=20, index=20)).argmax() == HELD_FRAMES - 1
