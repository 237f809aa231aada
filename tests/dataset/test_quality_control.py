"""No recording of an expert is rejected; corrupt ones are."""

import dataclasses

import numpy as np
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset.quality_control import broken_rules
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.dataset.episodes import changed
from tests.synthetic import synthetic_episode

KINDS = len(BENCHMARK.splits["train"].motions)


@pytest.mark.parametrize(
    ("capture", "options", "count"),
    [
        ("contact", {}, KINDS),
        ("contact", {"perturbed_share": 1.0}, 6),
        ("attach", {"control_class": "late", "protocol": "direct_act"}, 8),
        ("attach", {"split": "ood_speed"}, 8),
        ("contact", {"split": "ood_speed"}, 6),
    ],
)
def test_experts_recordings_pass(capture, options, count):
    episodes = list(record(Recording.of(capture=capture, image_size=0, **options), range(count)))
    assert len(episodes) > 0.8 * count
    found = {episode.meta.seed: broken(episode) for episode in episodes}
    assert not any(found.values()), found


def broken(episode: Episode, **changes: str) -> list[str]:
    """The rules that an episode breaks under its own capture rule and control class, or others."""
    return broken_rules(
        dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, **changes))
    )


@pytest.mark.parametrize(
    ("corrupt", "broken"),
    [
        (changed("state", (9, 0), np.nan), ["not_finite"]),
        (changed("state", (9, 2), 3.0), ["out_of_limits", "jumps"]),
        (changed("action", (9, 5), 2.4), ["out_of_limits"]),
        (changed("state", (9, 1), lambda y: y + 0.25), ["jumps"]),
        (changed("state", (9, 8), 1.5), ["jumps"]),
        (changed("executed_action", (9, 1), lambda y: y + 0.25), ["jumps"]),
        (changed("target_pose_h", (9, 1), lambda y: y + 1), ["teleports"]),
        (changed("action", (slice(8, None), 0), 2.0), ["saturated"]),
        (changed("state", slice(9, 20), lambda s: s[:1]), ["jumps", "frozen"]),
        (changed("phase", 9, 0.5), ["phases_out_of_order"]),
    ],
)
def test_corrupt_recordings_are_rejected(corrupt, broken: list[str]):
    assert broken_rules(corrupt(synthetic_episode(0))) == broken


def test_the_speed_of_the_class_decides_what_is_a_jump():
    moved = changed("state", (9, 1), lambda y: y + 0.08)(synthetic_episode(0))
    for control_class in ("standard", "late"):
        assert broken(moved, control_class=control_class) == ["jumps"]
    assert not broken(moved, control_class="unlimited")
    assert not broken(moved, control_class="standard", capture="contact"), (
        "its gantry is as fast as `unlimited`"
    )


def test_the_range_of_the_slides_is_that_of_the_world():
    """The same numbers in the home frame are possible at one home and not at another."""
    episode = synthetic_episode(0)
    beside_the_end = dataclasses.replace(episode, home_pos_w=np.array([1.9, 0.0, 1.0], np.float32))
    assert not broken_rules(episode)
    assert broken_rules(beside_the_end) == ["out_of_limits"]
