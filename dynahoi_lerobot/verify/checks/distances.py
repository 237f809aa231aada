"""Distances, localisation and contacts are those of the stored poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.conventions import CONTROL_DT, FINGERS, PALM_DOF
from dynahoi_lerobot.core.features import PRIMITIVE_NAMES
from dynahoi_lerobot.core.numerics import quat_to_matrix
from dynahoi_lerobot.core.rules import is_acting
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.objects.primitives import from_table
from dynahoi_lerobot.scene.signed_distance import signed_distance
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns
from dynahoi_lerobot.world.batch import TOUCH_M

START_TOLERANCE_M = 1e-5
"""At the start ``palm_distance`` is the distance itself, up to float32."""
ABOVE_M = 0.005
"""A least distance exceeds the distance at the end of its step by at most this: where contact releases the target, the
step is simulated twice (0.002 m seen)."""
BELOW_M = 0.006
"""How far a least distance lies below the straight line between two frames, beyond what changing velocities explain."""
TIP_TOLERANCE_M = 1e-5
"""Of distances that are computed again from the object's solids and from poses in float32."""


@CHECKS.register("distances")
class Distances(Check):
    """Bounds ``palm_distance`` by the poses, measures fingertips to solids; ``localized`` and contacts follow."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield distances that the poses do not have, and flags that the distances do not give."""
        palm = np.asarray(row["stats/palm_distance"], float)
        tips = np.asarray(row["stats/fingertip_distance"], float)
        frames = len(columns["index"])
        if palm.shape != (frames,) or tips.shape != (frames,):
            return  # said by `episode_columns`
        measured = tip_distances(row, columns)
        problems = (
            _palm(palm, columns),
            _localized(CAPTURES[row["capture"]].localization_radius_m, palm, columns),
            _tips(tips, measured),
            _contacts(row, measured, columns),
        )
        yield from (f"episode {row['episode_index']}, frame {problem}" for problem in problems if problem)


def _palm(palm: np.ndarray, columns: Columns) -> str | None:
    """Find a least distance of a step that is larger than at its end, or smaller than on the straight line."""
    state, target = columns["observation.state"][:, :PALM_DOF], columns["target.pose"][:, :3]
    offset = target.astype(float) - state
    distance = np.linalg.norm(offset, axis=1)
    low = np.concatenate([distance[:1] - START_TOLERANCE_M, _nearest(offset) - _bend(columns) - BELOW_M])
    high = distance + np.where(np.arange(len(palm)) == 0, START_TOLERANCE_M, ABOVE_M)
    frame = int(np.maximum(palm - high, low - palm).argmax())
    if low[frame] <= palm[frame] <= high[frame]:
        return None
    return f"{frame}: palm_distance is {palm[frame]:.4f} m; the poses give {low[frame]:.4f} to {high[frame]:.4f} m"


def _nearest(offset: np.ndarray) -> np.ndarray:
    """Return (T - 1,) the least distance to the origin of the segments between (T, 3) points."""
    start, step = offset[:-1], np.diff(offset, axis=0)
    share = -(start * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-12)
    return np.linalg.norm(start + np.clip(share, 0, 1)[:, None] * step, axis=1)


def _bend(columns: Columns) -> np.ndarray:
    """Return (T - 1,) how far from a straight line changes of velocity may have led target and palm [m].

    A change v of velocity leads at most v * 0.05 s / 4 astray. The target's is stored; the palm's, which is not, is
    at most twice the change of its mean velocity from a frame to the next or from the one before.
    """
    target = np.linalg.norm(np.diff(columns["target.velocity"][:, :3], axis=0), axis=1)
    steps = np.diff(columns["observation.state"][:, :PALM_DOF], axis=0)  # (T - 1, 3)
    turns = np.linalg.norm(np.diff(steps, axis=0, prepend=steps[:1], append=steps[-1:]), axis=1)  # (T,)
    return CONTROL_DT / 4 * target + np.maximum(turns[:-1], turns[1:]) / 2


def _localized(radius_m: float, palm: np.ndarray, columns: Columns) -> str | None:
    """Find a frame that is localised without the palm having been near, or the other way round."""
    acting = is_acting(columns["observation.phase"])
    acting = np.concatenate([[False], acting[:-1]])  # a distance is that of the step before its frame
    wanted = np.maximum.accumulate((palm < radius_m) & acting)
    wrong = np.flatnonzero(columns["localized"][:, 0].astype(bool) != wanted)
    if not wrong.size:
        return None
    frame = int(wrong[0])
    return f"{frame}: localized is {bool(columns['localized'][frame, 0])}; palm_distance says {bool(wanted[frame])}"


def _tips(tips: np.ndarray, measured: np.ndarray) -> str | None:
    """Find a fingertip distance (T,) that is not the least of the five ``measured`` (T, 5) ones, 0 inside."""
    wanted = np.maximum(measured.min(axis=1), 0.0)
    apart = np.abs(tips - wanted)
    if apart.max() <= TIP_TOLERANCE_M:
        return None
    frame = int(apart.argmax())
    return f"{frame}: fingertip_distance is {tips[frame]:.4f} m; object and poses give {wanted[frame]:.4f} m"


def tip_distances(row: EpisodeRow, columns: Columns) -> np.ndarray:
    """Return (T, 5), signed distance of each fingertip to the solids of the object [m], negative inside."""
    pads = columns["observation.fingertips"].reshape(-1, len(FINGERS), 6)[..., :3].astype(float)
    pose = columns["target.pose"].astype(float)
    # a row vector times a rotation is turned back: from the world's frame into the object's, then into the solid's
    local = (pads - pose[:, None, :3]) @ quat_to_matrix(pose[:, 3:] / np.linalg.norm(pose[:, 3:], axis=1)[:, None])
    solids = from_table(np.reshape(row["stats/object_primitives"], (-1, len(PRIMITIVE_NAMES))))
    distances = [
        signed_distance(s.shape, (local - s.pos) @ quat_to_matrix(np.array(s.quat)), np.array(s.half_size))
        for s in solids
    ]
    return np.min(distances, axis=0)


def _contacts(row: EpisodeRow, measured: np.ndarray, columns: Columns) -> str | None:
    """Find contacts that forces or distances contradict."""
    contacts = columns["target.contacts"]
    if not np.isin(contacts, (0, 1)).all():
        return f"{int((~np.isin(contacts, (0, 1))).any(axis=1).argmax())}: target.contacts is neither 0 nor 1"
    if CAPTURES[row["capture"]].uses_contact_sensors:
        wrong = (contacts != (columns["observation.touch"] > 0)).any(axis=1)
    else:
        on_edge = np.abs(measured - TOUCH_M) <= TIP_TOLERANCE_M
        wrong = (~on_edge & (contacts != (measured <= TOUCH_M))).any(axis=1)
    if not wrong.any():
        return None
    frame = int(wrong.argmax())
    return f"{frame}: target.contacts is {contacts[frame].tolist()}, which touch or fingertips contradict"
