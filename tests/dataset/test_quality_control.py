"""No recording of an expert is rejected; corrupt ones are."""

import dataclasses

import numpy as np
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset.quality_control import trajectory_problems
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
    found = {episode.meta.seed: problems(episode) for episode in episodes}
    assert not any(found.values()), found


def problems(episode: Episode, **changes: str) -> list[str]:
    """What is wrong with an episode under its own capture rule and control class, or others."""
    return trajectory_problems(
        dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, **changes))
    )


@pytest.mark.parametrize(
    ("corrupt", "told"),
    [
        (changed("state", (9, 0), np.nan), "state"),
        (changed("state", (9, 2), 3.0), "palm at 3.00 m along axis 2 at frame 9"),
        (changed("action", (9, 5), 2.4), "action has joint angles"),
        (changed("state", (9, 1), lambda y: y + 0.25), "state jumps by 0.2"),
        (changed("state", (9, 8), 1.5), "state jumps by 1.5"),
        (changed("executed_action", (9, 1), lambda y: y + 0.25), "executed_action jumps by 0.2"),
        (changed("target_pose_h", (9, 1), lambda y: y + 1), "target_pose jumps by 1.0"),
        (changed("action", (slice(8, None), 0), 2.0), "action[0] is at its limit"),
        (changed("state", slice(9, 20), lambda s: s[:1]), "state is frozen"),
        (changed("phase", 9, 0.5), "phase is not"),
    ],
)
def test_corrupt_recordings_are_rejected(corrupt, told):
    assert any(told in problem for problem in trajectory_problems(corrupt(synthetic_episode(0))))


def test_the_speed_of_the_class_decides_what_is_a_jump():
    moved = changed("state", (9, 1), lambda y: y + 0.08)(synthetic_episode(0))
    for control_class in ("standard", "late"):
        (problem,) = problems(moved, control_class=control_class)
        assert "m at frame 9; 0.06 m is possible" in problem
    assert not problems(moved, control_class="unlimited")
    assert not problems(moved, control_class="standard", capture="contact"), (
        "its gantry is as fast as `unlimited`"
    )


def test_the_range_of_the_slides_is_that_of_the_world():
    """The same numbers in the home frame are possible at one home and not at another."""
    episode = synthetic_episode(0)
    beside_the_end = dataclasses.replace(episode, home_pos_w=np.array([1.9, 0.0, 1.0], np.float32))
    (problem,) = trajectory_problems(beside_the_end)
    assert "-3.90 to 0.10 m are possible" in problem
