"""Computes the paper's seven metrics from a dataset's parquet files, with nothing but pandas and
numpy.

It is written from the definitions of the paper (Section "Evaluation metrics" and Appendix
"Evaluation Criteria") and imports nothing of the package, so it is also an example of how others
can read the dataset::

    python tests/recompute_metrics.py DATASET
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

UNIT_M = 0.1
RADIUS_M = {"attach": 0.03, "attach_lenient": 0.1, "contact": 0.03}
"""Palm center to object center, below which the object is localized, by capture rule."""
GRASP_SHARE = 0.9
REST_M = 1e-6
"""Steps of the palm up to this length are jitter of a servo that holds still."""
STILL_M = 1e-3
"""A palm that stays this close to where it begins stands still, though closing fingers shake it."""


def metrics(root: Path) -> pd.DataFrame:
    """Return S_loc, S_gra, E_loc, E_gra, Q_smooth, Q_line and R_time of each episode, indexed by
    ``episode_index``.

    S_gra is NaN where the target was never localized, and under the capture rule contact. E_loc
    and E_gra are in u (0.1 m).
    """
    keys = ["episode_index", "frame_index"]
    episodes = pd.read_parquet(root / "meta/episodes").merge(
        pd.read_parquet(root / "meta/privileged_episodes"), on=keys[0]
    )
    frames = pd.read_parquet(root / "data").merge(
        pd.read_parquet(root / "meta/privileged"), on=keys
    )
    facts = episodes.set_index(keys[0])
    rows = {
        index: _metrics(facts.loc[index], shown)
        for index, shown in frames.sort_values(keys).groupby(keys[0])
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def _metrics(episode: pd.Series, frames: pd.DataFrame) -> dict[str, float]:
    start = int(episode["window_frames"])
    palm_distance_m = frames["palm_distance"].to_numpy(float)  # least of the step to the frame
    # the hand moves from frame `start` on
    inside = np.flatnonzero(palm_distance_m[start + 1 :] < RADIUS_M[episode["capture"]])
    first = start + 1 + int(inside[0]) if inside.size else None
    state = np.stack(frames["observation.state"]).astype(float)
    path = state[start : None if first is None else first + 1, :3]
    judged = first is not None and episode["capture"] != "contact"
    return {
        "S_loc": float(first is not None),
        "S_gra": float(_grasps(episode, state[first, 3:])) if judged else np.nan,
        "E_loc": palm_distance_m[start:].min() / UNIT_M,
        "E_gra": frames["fingertip_distance"].to_numpy(float)[start:].min() / UNIT_M,
        "Q_smooth": smoothness(path),
        "Q_line": linearity(path),
        "R_time": 0.0
        if first is None
        else float(np.clip(1 - (first - start) / episode["length_frames"], 0, 1)),
    }


def _grasps(episode: pd.Series, joints: np.ndarray) -> bool:
    """Whether all 15 joints have made 0.9 of the reference rotation, in its direction."""
    rest, reference = (
        np.asarray(episode[f"{name}_joints"], float) for name in ("open", "reference")
    )
    turned = joints - rest
    wanted = reference - rest
    return bool((turned * np.sign(wanted) >= GRASP_SHARE * np.abs(wanted) - 1e-6).all())


def _steps(path: np.ndarray) -> np.ndarray:
    if np.linalg.norm(path - path[0], axis=1).max() <= STILL_M:
        return np.zeros((len(path) - 1, 3))
    steps = np.diff(path, axis=0)
    return np.where(np.linalg.norm(steps, axis=1, keepdims=True) > REST_M, steps, 0.0)


def smoothness(path: np.ndarray) -> float:
    lengths = np.linalg.norm(_steps(path), axis=1)
    return 1.0 if not lengths.any() else float(1 / (1 + lengths.std() / lengths.mean()))


def linearity(path: np.ndarray) -> float:
    steps = _steps(path)
    way = path[-1] - path[0]
    if not len(steps) or np.linalg.norm(way) <= REST_M:
        return 0.0
    lengths = np.linalg.norm(steps, axis=1)
    moving = lengths > 0
    cosines = steps[moving] @ way / (lengths[moving] * np.linalg.norm(way))
    return float(cosines.sum() / len(steps))


if __name__ == "__main__":
    computed = metrics(Path(sys.argv[1]))
    print(pd.concat([computed, computed.mean().to_frame("mean").T]).to_string(float_format="%.4f"))
