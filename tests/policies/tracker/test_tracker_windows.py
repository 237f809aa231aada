"""Which frames and actions belong to a decision."""

from __future__ import annotations

import pytest
from lerobot_policy_tracker.windows import DecisionWindows
from tracker_helpers import TINY

WINDOWS = [
    DecisionWindows(5, 2, 16),
    DecisionWindows(0, 2, 16),
    DecisionWindows(5, 2, 16, 4, 4),
    DecisionWindows(3, 3, 8, 3, 2),
]


@pytest.mark.parametrize("windows", WINDOWS)
def test_every_decision_sees_its_own_past_and_nothing_later(windows: DecisionWindows) -> None:
    for moment, row in zip(windows.decision_moments, windows.frame_index, strict=True):
        seen = [windows.observation_offsets[i] - moment for i in row]
        assert seen == windows.lookback
        assert max(seen) == 0


@pytest.mark.parametrize("windows", WINDOWS)
def test_every_chunk_starts_at_its_decision(windows: DecisionWindows) -> None:
    for moment, row in zip(windows.decision_moments, windows.action_index, strict=True):
        assert [windows.action_offsets[i] for i in row] == list(range(moment, moment + windows.horizon))


def test_shared_frames_are_loaded_once() -> None:
    windows = DecisionWindows(n_obs_frames=5, obs_stride=2, horizon=16, n_decisions=4, decision_stride=4)
    assert windows.observation_offsets == list(range(-10, 13, 2))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"n_obs_frames": -1}, "n_obs_frames is -1"),
        ({"n_action_steps": 99}, "n_action_steps is 99, but must be 1 to 8"),
        ({"latency_frames": 5, "n_action_steps": 4}, r"latency_frames is 5, but must be 0 to 4 \(horizon - n_action"),
        ({"action_frame": "delta"}, "one of auto, absolute, relative"),
        ({"ema_decay": 1.0}, "ema_decay is 1.0"),
        ({"noise_scale": -0.5}, "noise_scale is -0.5, but must be 0 or more"),
        ({"width": 18}, "width is 18"),
        ({"obs_stride": 0}, "obs_stride is 0, but must be 1 or more"),
    ],
)
def test_bad_settings_name_value_and_limit(changes: dict, sentence: str) -> None:
    from lerobot_policy_tracker import TrackerConfig

    with pytest.raises(ValueError, match=sentence):
        TrackerConfig(**{**TINY, **changes})
