"""The hand sees what it should watch; ``benchmarks/visibility.py`` measures the same on more episodes."""

from __future__ import annotations

import numpy as np

from benchmarks.visibility import Watched, summarize, watch
from dynahoi_lerobot.episode_spec import EpisodeSpec
from tests.world.playing import world


def test_at_least_95_percent_of_episodes_see_their_target_in_80_percent_of_the_window(specs: list[EpisodeSpec]):
    batch = world(specs[:22], image_size=64)
    watched = watch(batch, specs[:22]) + watch(batch, specs[22:])
    assert np.mean([one.seen for one in watched]) >= 0.95
    assert [len(one.pixels) for one in watched] == [-(-spec.window_frames // 2) for spec in specs]


def test_the_table_counts_frames_with_pixels():
    watched = [
        Watched("ramp", np.array([0, 3, 3, 3, 3])),
        Watched("ramp", np.array([0, 0, 1])),
        Watched("lob", np.ones(4)),
    ]
    table = summarize(watched)
    assert list(table) == ["lob", "ramp", "all"]
    assert table["ramp"] == {"seen": 0.5, "frames": (0.8 + 1 / 3) / 2, "pixels": 2.0}
