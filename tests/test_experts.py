"""The demonstrator solves the benchmark; the floor does not; between them lies a straight
extrapolation.
"""

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.core.agent import WorldState
from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.dataset.quality_control import broken_rules
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.experts.baselines import fixed_path, home_table
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.experts.match import approach
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.rollout.teacher_labels import Perturbation
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import played, wait, world


def mean(episodes: list[Episode], metric: str) -> float:
    values = [
        value for value in (measure(episode)[metric] for episode in episodes) if value is not None
    ]
    return float(np.mean(values))


def test_the_expert_catches_everything_at_the_first_attempt_straight_smooth_and_early(
    expert_episodes, specs
):
    assert mean(expert_episodes, "S_loc") == mean(expert_episodes, "S_gra") == 1.0
    for episode, spec in zip(expert_episodes, specs, strict=True):
        assert (episode.success, episode.stage, episode.meta.attempts) == (True, "captured", 1)
        assert episode.first_localized <= spec.intercept_frame + 1, (
            "where a slower hand meets it, or before"
        )
    assert mean(expert_episodes, "Q_line") >= 0.98
    assert mean(expert_episodes, "Q_smooth") >= 0.98
    assert mean(expert_episodes, "R_time") >= 0.5


def test_baselines_that_see_nothing_are_not_privileged():
    assert {name for name in EXPERTS.names() if not EXPERTS[name].privileged} == {
        "hold",
        "blind_path",
    }


def test_the_stored_path_is_of_a_known_control_class():
    with pytest.raises(ValueError, match="'brisk', only for standard, late, unlimited"):
        fixed_path("brisk")


@pytest.mark.parametrize("name", EXPERTS.names())
def test_every_expert_is_deterministic_and_commands_every_joint(
    name: str, specs: list[EpisodeSpec]
):
    batch = WorldBatch(Rules(image_size=32), 4, threads=1)
    batch.reset(range(3), specs[:3])
    for _ in range(specs[0].window_frames + 3):
        world = batch.world_state(batch.observe(images=False))
        commands = EXPERTS[name]().act(world)
        np.testing.assert_array_equal(commands, EXPERTS[name]().act(world))
        assert commands.shape == (4, 18)
        assert np.isfinite(commands).all()
        batch.step(commands, np.arange(3))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("constant_velocity", "constant"),
        ("constant_acceleration", "accelerating"),
        ("constant_acceleration", "lob"),
    ],
)
def test_who_extrapolates_rightly_goes_where_the_expert_goes(name: str, kind: str):
    batch = world(sample_specs(Recipe(split="test", motions=(kind,)), range(6)))
    wait(batch)
    seen = batch.world_state(batch.observe(images=False))
    np.testing.assert_allclose(
        EXPERTS[name]().act(seen)[:, :3], Intercept().act(seen)[:, :3], atol=1e-3
    )


def test_a_hand_at_a_tabulated_home_follows_the_path_from_there(specs: list[EpisodeSpec]):
    homes_w, paths = home_table()
    batch = world([replace(specs[0], home_pos_w=homes_w[7])])
    wait(batch)
    (command,) = EXPERTS["nearest_home"]().act(batch.world_state(batch.observe(images=False)))
    np.testing.assert_allclose(command[:3], paths[7][0], atol=1e-9)


@pytest.mark.parametrize("control_class", CONTROL_CLASSES)
def test_the_expert_catches_everything_in_every_control_class(control_class: str, in_class):
    episodes = in_class(control_class)
    assert {episode.stage for episode in episodes} == {"captured"}
    assert {episode.meta.control_class for episode in episodes} == {control_class}
    for episode in episodes:
        speed = np.linalg.norm(np.diff(episode.palm_pos_h, axis=0), axis=1) / CONTROL_DT
        assert speed.max() < 1.02 * CONTROL_CLASSES[control_class].palm_speed_m_s


def test_a_hand_that_follows_the_labels_loosely_is_closed_when_it_gets_there(
    specs: list[EpisodeSpec],
):
    rng = np.random.default_rng(0)

    class Loose(Intercept):
        def act(self, world: WorldState) -> np.ndarray:
            labels = self.label(world)
            return labels + np.pad(rng.normal(0.0, 0.015, (len(labels), 3)), ((0, 0), (0, 15)))

    episodes = played(Rules(image_size=0), Loose(), specs[:22])
    assert mean(episodes, "S_joint") >= 0.9 * mean(episodes, "S_loc")


def test_the_label_is_the_meeting_and_in_the_window_that_of_the_start_of_control(
    specs: list[EpisodeSpec],
):
    recipe = Recording.of(image_size=0, split=specs[0].split, perturbed_share=0.0)
    for episode in record(recipe, [spec.seed for spec in specs[:22]]):
        assert not broken_rules(episode)
        window = episode.meta.window_frames
        path = episode.target_path_h
        free = int(np.flatnonzero(~episode.localized)[-1]) + 1
        apart = np.linalg.norm(path - episode.action[:free, None, :3], axis=-1)
        assert apart.min(axis=1).max() < 1e-6
        assert (episode.action[:window] == episode.action[window]).all()
        caught = episode.action[free:, :3] - episode.palm_pos_h[free:]
        assert np.abs(caught).max() < 2e-3
        assert 8 <= len(episode) - free <= 12


def test_the_expert_finds_back_when_its_palm_is_pulled_away():
    pulled = Recording.of(image_size=0, perturbed_share=1.0)
    episodes = list(record(pulled, range(22)))
    assert len(episodes) >= 0.9 * 22
    assert not any(map(broken_rules, episodes))
    strayed_m = []
    for episode in episodes:
        free = slice(episode.meta.window_frames, int(np.flatnonzero(~episode.localized)[-1]) + 1)
        towards = episode.action[free, :3] - episode.palm_pos_h[free]
        moved = episode.executed_action[free, :3] - episode.palm_pos_h[free]
        lengths = np.linalg.norm(towards, axis=1) * np.linalg.norm(moved, axis=1)
        strayed_m.append((np.sum(towards * moved, axis=1) < 0.5 * lengths).mean())
    assert 0.1 < np.mean(strayed_m) < 0.9


def test_a_palm_beyond_the_target_goes_around_it_to_close_from_behind():
    ways = [np.array([0.25, 0.02, 0.0])]
    while not (step := approach(ways[-1]))[1]:
        ways.append(step[0])
        assert len(ways) < 20
    along = np.array(ways)[:, 0]
    across = np.linalg.norm(np.array(ways)[:, 1:], axis=1)
    assert across[(along > -0.01) & (along < 0.11)].min() > 0.07
    assert along[-1] < 0


def test_three_attempts_are_perturbed_each_differently_and_a_further_one_is_not(
    specs: list[EpisodeSpec],
):
    *perturbed, last = (Perturbation.drawn(specs[0], attempt, share=1.0) for attempt in range(1, 5))
    assert all((drawn.pull_begin >= 0).any() and drawn.tremor_m.any() for drawn in perturbed)
    assert len({drawn.pull_m.tobytes() for drawn in perturbed}) == 3
    assert not (last.pull_begin >= 0).any()
    assert not last.tremor_m.any()
