"""Protocol ``occluded``: a screen hides the target for a while before it can be met, and stands in
nobody's way.
"""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from benchmarks.pin import spec_digest
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene.clearance import box_distance
from dynahoi_lerobot.scene.screen import apart, earliest_meeting, with_screen
from tests.world.playing import played, world

OCCLUDED = Recipe.of(split="test", image_size=16, protocol="occluded")


@pytest.fixture(scope="module")
def occluded(once) -> list[EpisodeSpec]:
    """The first 22 episodes of ``test``: every kind once."""
    return once("occluded", lambda _: sample_specs(OCCLUDED, range(22)))


@pytest.mark.parametrize("actor", ["intercept", "hold"])
def test_no_pixel_of_the_target_shows_for_6_to_12_frames_before_it_can_be_met(
    occluded: list[EpisodeSpec], actor: str
):
    without = [replace(spec, appearance=replace(spec.appearance, screen=None)) for spec in occluded]
    shown, bare = (target_pixels(specs, actor) for specs in (occluded, without))
    for i, spec in enumerate(occluded):
        meeting = earliest_meeting(spec)
        gone = shown[:meeting, i] == 0
        by_screen = gone & (bare[:meeting, i] > 0)
        lengths = run_lengths(gone)
        last = int(np.flatnonzero(gone)[-1])
        assert lengths[-1] >= 6, (spec.motion.name, lengths)
        assert max(run_lengths(by_screen)) <= 12, (spec.motion.name, spec.seed)
        assert last >= meeting - 4, (spec.motion.name, last, meeting)
        assert (shown[: spec.window_frames, i] > 0).sum() >= 3, spec.motion.name


def target_pixels(specs: list[EpisodeSpec], actor: str) -> np.ndarray:
    """(F, N) pixels of each target in the view of the hand, until the last one can be met."""
    batch = world(specs, image_size=96)
    expert = EXPERTS[actor]()
    counts = []
    for _ in range(max(map(earliest_meeting, specs))):
        counts.append(
            np.isin(batch.cameras.segmentation(), batch.scene.target_geoms).sum(axis=(1, 2))
        )
        batch.step(expert.act(batch.world_state(batch.observe(images=False))))
    return np.array(counts)


def run_lengths(flags: np.ndarray) -> list[int]:
    """How many consecutive frames hold, run by run."""
    return [sum(1 for _ in run) for held, run in groupby(flags) if held] or [0]


def test_episodes_are_those_of_observe_before_act_or_else_no_screen_can_stand_in_these(
    specs, occluded
):
    kept = 0
    for plain, spec in zip(specs[:22], occluded, strict=True):
        assert plain.appearance.screen is None
        expected = with_screen(replace(plain, protocol="occluded"))
        if expected is None:
            assert spec.home_pos_w.tolist() != plain.home_pos_w.tolist(), "it was drawn again"
        else:
            assert spec_digest(spec) == spec_digest(expected)
            kept += 1
    assert 5 <= kept < 22


def test_the_screen_is_clear_of_palm_target_fixtures_and_floor(occluded: list[EpisodeSpec]):
    for spec in occluded:
        screen = spec.appearance.screen
        share = np.linspace(0.0, 1.0, 50)[:, None]
        panel = Box(screen.pos_w, (screen.half_size[0], screen.half_size[1], screen.half_size[2]))
        way = spec.home_pos_w + share * (spec.intercept_pos_w - spec.home_pos_w)
        assert box_distance(way, panel).min() > 0.025, spec.motion.name
        assert box_distance(spec.target_path_w, panel).min() > spec.target.grasp_radius_m, (
            spec.motion.name
        )
        assert screen.pos_w[2] > screen.half_size[2]
        assert all(apart(panel, box, 0.0) for box in spec.motion.launch(spec.target).boxes), (
            spec.motion.name
        )


@pytest.mark.parametrize(("turn_rad", "clear"), [(0.0, True), (np.pi / 4, False)])
def test_boxes_are_apart_if_an_axis_separates_them(turn_rad: float, clear: bool):
    panel = Box((0.0, 0.0, 1.0), (0.01, 0.5, 0.5))
    quat = (float(np.cos(turn_rad / 2)), 0.0, 0.0, float(np.sin(turn_rad / 2)))
    assert apart(panel, Box((0.12, 0.0, 1.0), (0.1, 0.1, 0.1), quat), 0.005) == clear


@pytest.mark.parametrize("control_class", ["standard", "late"])
def test_the_expert_catches_every_target(occluded: list[EpisodeSpec], control_class: str):
    rules = replace(OCCLUDED.rules, control_class=control_class)
    assert all(episode.success for episode in played(rules, EXPERTS["intercept"](), occluded))
