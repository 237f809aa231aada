"""Claim of the verdicts: verdicts and metrics follow from the columns.

States give fingertips; poses and solids give distances; distances give localization and contacts;
these and the capture rule give the verdict. Metrics are computed from these columns whenever they
are asked for, so nothing else is stored.
"""

from collections.abc import Iterator

import mujoco
import numpy as np
import pyarrow as pa

from dynahoi_lerobot.captures import CAPTURES, CaptureRule, Track
from dynahoi_lerobot.core.conventions import CONTROL_DT, FINGERS
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.numerics import matrix_to_rotvec, quat_to_matrix, segment_distance
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES, is_acting, one_hot_phase
from dynahoi_lerobot.dataset.columns import (
    LANGUAGE,
    Features,
    column_array,
    content_arrays,
    described_features,
    subtask_rows,
)
from dynahoi_lerobot.dataset.quality_control import not_finite
from dynahoi_lerobot.objects.primitives import from_table
from dynahoi_lerobot.rollout.recorder import TOUCH_M, next_frames
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.scene.signed_distance import signed_distance

TIP_TOLERANCE = 2e-5
"""Of fingertips and of distances that are computed again from numbers in float32 [m, rad]."""
START_TOLERANCE_M = 1e-5
"""At the start ``palm_distance_m`` is the distance itself, up to float32."""
ABOVE_M = 0.005
"""A least distance exceeds the distance at the end of its step by at most this: where contact
releases the target, the step is simulated twice (0.002 m seen)."""
BELOW_M = 0.006
"""How far a least distance lies below the straight line between two frames, beyond what changing
velocities explain."""
DERIVED_TOLERANCE = 1e-6
"""Of columns in float32 that are computed again from others; another processor rounds otherwise."""
PALM_ONLY = ("touched", "missed")
"""Stage of a failure in which only the palm touched the target, stored and as the stored columns
tell it: that the palm did is not among them, and only a replay can say."""


def verdict_problems(episode: Episode, hand: str | None) -> Iterator[str]:
    """Yield columns that do not follow from those before them; where no ``hand`` is known,
    fingertips are believed.
    """
    problem = not_finite(episode)
    if problem:
        yield problem
        return
    if hand is not None:
        yield from _fingertips(episode, hand)
    if not 0 <= episode.meta.window_frames < len(episode):
        yield f"it is observed for {episode.meta.window_frames} of its {len(episode)} frames"
        return
    rule = CAPTURES[episode.meta.capture]()
    tips = tip_distances(episode)  # (T, 5)
    yield from _palm(episode)
    yield from _tips(episode, tips)
    yield from _contacts(episode, rule, tips)
    track = _track(episode)
    latency = CONTROL_CLASSES[episode.meta.control_class].latency_frames
    acting = np.arange(len(episode)) + latency >= episode.meta.window_frames  # (T,)
    if not np.array_equal(episode.phase, one_hot_phase(acting)):
        yield (
            f"phase is not that of an episode that is observed for "
            f"{episode.meta.window_frames} frames"
        )
    commanded = np.concatenate([[False], acting[:-1]])  # (T,) in the step that ends at the frame
    localized = np.maximum.accumulate(
        (episode.palm_distance_m < rule.localization_radius_m) & commanded
    )
    before = np.zeros(episode.meta.window_frames, bool)
    flags = {
        "localized": localized,
        "captured": np.concatenate([before, rule.captured(track)]),
        "succeeded": next_frames(np.concatenate([before, rule.succeeded(track)])),
    }
    for name, wanted in flags.items():
        for frame in np.flatnonzero(getattr(episode, name) != wanted)[:1]:
            yield (
                f"{name} is {not wanted[frame]} at frame {frame}; rule {rule.name!r} says "
                f"{wanted[frame]}"
            )
    for name, wanted in (("success", rule.success(track)), ("stage", rule.stage(track))):
        found = getattr(episode, name)
        if found != wanted and (found, wanted) != PALM_ONLY:
            yield f"{name} is {found!r}; rule {rule.name!r} says {wanted!r}"


def derived_problems(features: Features, frames: pa.Table, episode: Episode) -> Iterator[str]:
    """Yield columns of an episode's rows of the frame table that hold something else than the
    episode's other columns give, such as rewards and subtasks.
    """
    columns = described_features(features).values()
    arrays = content_arrays(episode, [feature for feature in columns if feature.derived])
    for key, wanted in arrays.items():
        apart = np.abs(column_array(frames, key).astype(float) - wanted).max(axis=1)
        for frame in np.flatnonzero(~(apart <= DERIVED_TOLERANCE))[:1]:
            yield f"{key} at frame {frame} is not what the other columns give"
    if LANGUAGE in features:
        subtasks = subtask_rows(is_acting(episode.phase), episode.localized)
        wanted = pa.array([subtasks] * len(episode), frames.schema.field(LANGUAGE).type)
        if frames[LANGUAGE].combine_chunks() != wanted:
            yield f"{LANGUAGE} holds other subtasks than the phases and localization give"


def _fingertips(episode: Episode, hand: str) -> Iterator[str]:
    """Find fingertips that are not where forward kinematics puts them."""
    apart = np.abs(fingertip_poses(episode.state, hand) - episode.fingertips)
    # a rotation vector of half a turn has two signs
    apart = np.minimum(apart, np.abs(apart - 2 * np.pi)).max(axis=1)
    for frame in np.flatnonzero(~(apart <= TIP_TOLERANCE))[:1]:
        yield (
            f"fingertips at frame {frame} are {apart[frame]:.2g} m or rad off the kinematics of "
            f"the state"
        )


def fingertip_poses(state: np.ndarray, hand: str) -> np.ndarray:
    """Return (T, 30), position [m] and rotation vector [rad] of each fingertip, of (T, 18) states
    of a hand.
    """
    scene = compile_scene(hand)
    data = mujoco.MjData(scene.model)
    position = np.empty((len(state), len(FINGERS), 3))
    rotation = np.empty((len(state), len(FINGERS), 3, 3))
    for frame, angles in enumerate(state):
        data.qpos[scene.hand_qpos] = angles
        mujoco.mj_kinematics(scene.model, data)
        position[frame] = data.site_xpos[scene.tip_sites]
        rotation[frame] = data.site_xmat[scene.tip_sites].reshape(-1, 3, 3)
    return np.concatenate([position, matrix_to_rotvec(rotation)], axis=-1).reshape(len(state), -1)


def _palm(episode: Episode) -> Iterator[str]:
    """Find a least distance of a step that is larger than at its end, or smaller than on the
    straight line.
    """
    offset = episode.target_pose_h[:, :3].astype(float) - episode.palm_pos_h
    distance = np.linalg.norm(offset, axis=1)
    found = episode.palm_distance_m
    straight = segment_distance(np.zeros((1, 3)), offset)[0]  # (T - 1,)
    low = np.concatenate([distance[:1] - START_TOLERANCE_M, straight - _bend(episode) - BELOW_M])
    high = distance + np.where(np.arange(len(found)) == 0, START_TOLERANCE_M, ABOVE_M)
    for frame in np.flatnonzero(~((low <= found) & (found <= high)))[:1]:
        yield (
            f"palm_distance at frame {frame} is {found[frame]:.4f} m; poses give "
            f"{low[frame]:.4f} to {high[frame]:.4f} m"
        )


def _bend(episode: Episode) -> np.ndarray:
    """Return (T - 1,) how far from a straight line changes of velocity may have led target and palm
    [m].

    A change v of velocity leads at most v * 0.05 s / 4 astray. The target's is stored; the palm's,
    which is not, is at most twice the change of its mean velocity from a frame to the next or from
    the one before.
    """
    target = np.linalg.norm(np.diff(episode.target_velocity_w[:, :3], axis=0), axis=1)
    steps = np.diff(episode.palm_pos_h, axis=0)  # (T - 1, 3)
    changes = np.diff(steps, axis=0, prepend=steps[:1], append=steps[-1:])  # (T, 3)
    turns = np.linalg.norm(changes, axis=1)  # (T,)
    return CONTROL_DT / 4 * target + np.maximum(turns[:-1], turns[1:]) / 2


def tip_distances(episode: Episode) -> np.ndarray:
    """Return (T, 5), signed distance of each fingertip to the solids of the object [m], negative
    inside.
    """
    pads = episode.fingertips.reshape(-1, len(FINGERS), 6)[..., :3].astype(float)
    pose = episode.target_pose_h.astype(float)
    # a row vector times a rotation is turned back: from the world's frame into the object's, then
    # into the solid's
    local = (pads - pose[:, None, :3]) @ quat_to_matrix(
        pose[:, 3:] / np.linalg.norm(pose[:, 3:], axis=1)[:, None]
    )
    distances = [
        signed_distance(
            s.shape, (local - s.pos) @ quat_to_matrix(np.array(s.quat)), np.array(s.half_size)
        )
        for s in from_table(episode.object_primitives)
    ]
    return np.min(distances, axis=0)


def _tips(episode: Episode, tips: np.ndarray) -> Iterator[str]:
    """Find a fingertip distance (T,) that is not the least of the five (T, 5) ones, 0 inside."""
    found = episode.fingertip_distance_m
    wanted = np.maximum(tips.min(axis=1), 0.0)
    for frame in np.flatnonzero(~(np.abs(found - wanted) <= TIP_TOLERANCE))[:1]:
        yield (
            f"fingertip_distance at frame {frame} is {found[frame]:.4f} m; object and poses give "
            f"{wanted[frame]:.4f} m"
        )


def _contacts(episode: Episode, rule: CaptureRule, tips: np.ndarray) -> Iterator[str]:
    """Find contacts that forces or distances contradict."""
    contacts = episode.target_contacts
    if rule.uses_contact_sensors:
        # `dynahoi encode` leaves the forces out, and only its source can say whether they agree
        wrong = contacts != (_forces(episode) > 0)
    else:
        wrong = (np.abs(tips - TOUCH_M) > TIP_TOLERANCE) & (contacts != (tips <= TOUCH_M))
    for frame in np.flatnonzero(wrong.any(axis=1))[:1]:
        yield (
            f"target_contacts at frame {frame} are {contacts[frame].tolist()}, which touch or "
            f"fingertips contradict"
        )


def _forces(episode: Episode) -> np.ndarray:
    """Return the fingers' forces on the target (T, 5), or, where they are not stored, contacts."""
    return episode.target_contacts if episode.touch is None else episode.touch


def _track(episode: Episode) -> Track:
    """Return what the rule judges; what touched the target besides fingers is not stored, so
    ``captured`` says it.
    """
    control = episode.control
    captured = episode.captured[control]
    return Track(
        joints=episode.joints[control],
        open_joints=episode.open_joints,
        reference_joints=episode.reference_joints,
        localized=episode.localized[control],
        contacts=TargetContacts(
            _forces(episode)[control], captured.astype(float), (~captured).astype(float)
        ),
        palm_distance_m=episode.palm_distance_m[control],
        palm_pos_h=episode.palm_pos_h[control],
    )
