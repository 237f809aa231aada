"""What the writer says about random small recordings is what their frames give, read by pandas."""

import json
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import CAMERA_KEY
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.video import Encoding, stored_packets
from tests.dataset.episodes import written
from tests.synthetic import synthetic_episode

SHARES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
TASKS = ("Catch it.", "Catch the red ball.", "Grasp the box.")

Statistics = dict[str, np.ndarray]


def recorded(seed: int, frames: int, task: str, image_size: int | None) -> Episode:
    episode = synthetic_episode(seed, frames=frames, image_size=image_size)
    return changed(episode, {"task": task})


@settings(max_examples=12, deadline=None)
@given(
    kinds=st.lists(st.tuples(st.integers(10, 30), st.sampled_from(TASKS)), min_size=1, max_size=6),
    image_size=st.sampled_from([None, 16]),
    codec=st.sampled_from(["h264", "images"]),
    data_mb=st.sampled_from([0.004, 100]),
    video_s=st.sampled_from([1.5, 3600]),
)
def test_what_is_written_about_episodes_is_what_their_frames_give(
    kinds, image_size, codec, data_mb, video_s
):
    episodes = [
        recorded(seed, frames, task, image_size) for seed, (frames, task) in enumerate(kinds)
    ]
    with TemporaryDirectory() as folder:
        root = Path(folder) / "d"
        limits = FileLimits(data_mb=data_mb, video_s=video_s)
        manifest = written(root, episodes, encoding=Encoding(codec), limits=limits).finish()
        assert manifest.episodes == len(episodes)
        assert manifest.frames == sum(map(len, episodes))
        assert manifest.seeds == list(range(len(episodes)))
        check_places(root, episodes)
        check_statistics(root, episodes)


def check_places(root: Path, episodes: Sequence[Episode]) -> None:
    """Where an episode's rows and images lie; `test_writer` reads them there."""
    rows = pd.read_parquet(root / "meta/episodes")
    lengths = [len(episode) for episode in episodes]
    ends = np.cumsum(lengths)
    assert rows["episode_index"].tolist() == list(range(len(episodes)))
    assert rows["length"].tolist() == lengths
    assert rows["dataset_from_index"].tolist() == (ends - lengths).tolist()
    assert rows["dataset_to_index"].tolist() == ends.tolist()
    assert [list(tasks) for tasks in rows["tasks"]] == [[e.meta.task] for e in episodes]
    for path in root.glob("videos/*/*/*.mp4"):
        place = f"videos/{path.parents[1].name}"
        held = rows[rows[f"{place}/file_index"] == int(path.stem.removeprefix("file-"))]
        until = held["length"].cumsum()
        np.testing.assert_allclose(held[f"{place}/from_timestamp"] * 20, until - held["length"])
        np.testing.assert_allclose(held[f"{place}/to_timestamp"] * 20, until)
        assert len([*stored_packets(path)]) == until.iloc[-1]


def check_statistics(root: Path, episodes: Sequence[Episode]) -> None:
    """Statistics of columns, of each episode and of all."""
    frames = pd.read_parquet(root / "data").sort_values("index")
    starts = np.cumsum([0, *map(len, episodes)])
    said = json.loads((root / "meta/stats.json").read_text())
    rows = pd.read_parquet(root / "meta/episodes").to_dict("records")
    for key, of_all in said.items():
        if key == CAMERA_KEY:
            continue
        values = np.stack(frames[key].map(np.atleast_1d).tolist())
        wanted = [statistics(values[start:stop]) for start, stop in pairwise(starts)]
        wanted.append(statistics(values))
        of_each = [{name: row[f"stats/{key}/{name}"] for name in of_all} for row in rows]
        for found, numbers in zip([*of_each, of_all], wanted, strict=True):
            assert found.keys() == numbers.keys()
            for name, value in numbers.items():
                np.testing.assert_allclose(
                    np.ravel(found[name]), value, 1e-6, 1e-9, err_msg=f"{key} {name}"
                )


def statistics(values: np.ndarray) -> Statistics:
    """Return those of (N, D) numbers; of all numbers that have their share at or below them, a
    quantile is the least.
    """
    ranked = np.sort(values.astype(float), axis=0)
    quantiles = {name: ranked[math.ceil(share * len(ranked)) - 1] for name, share in SHARES.items()}
    moments = {name: getattr(ranked, name)(axis=0) for name in ("min", "max", "mean", "std")}
    return moments | quantiles | {"count": np.array([len(ranked)])}
