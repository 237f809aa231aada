"""Synthetic episodes for tests that need no simulator: a straight reach that catches a constantly
moving point.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, LOCALIZATION_RADIUS_M
from dynahoi_lerobot.core.episode import Episode, EpisodeMeta
from dynahoi_lerobot.core.protocols import one_hot_phase
from dynahoi_lerobot.evaluate.results import Results, RunInfo
from dynahoi_lerobot.motions.straight_line import Constant
from dynahoi_lerobot.objects.primitives import Primitive, as_table, extent, solid_inertia
from dynahoi_lerobot.rollout.recorder import TOUCH_M, next_frames
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from dynahoi_lerobot.sampling.recipe import Recipe

REFERENCE = np.full(15, 1.0, np.float32)
BALL = (Primitive("sphere", (0.02,)),)
UPRIGHT = np.array([0.0, 0, 0, 1, 0, 0, 0], np.float32)
CONSTANTS: dict = {
    "object_primitives": as_table(BALL),
    "object_size": extent(BALL).astype(np.float32),
    "object_mass_kg": 0.125,
    "object_inertia": np.array(solid_inertia(BALL, 0.125), np.float32),
    "object_friction": np.array([0.75, 0.75], np.float32),
    "object_restitution": 0.0,
    "ego_camera_pose_palm": UPRIGHT,
    "side_camera_pose_h": UPRIGHT,
    "ego_intrinsics": np.full(4, 16.0, np.float32),
    "side_intrinsics": np.full(4, 16.0, np.float32),
    "hand_limits": np.array([0.5, 20.0, 0.0], np.float32),
    "first_plan": np.array([0.5, 1.0], np.float32),
}
"""What does not change within an episode: a ball, seen by cameras with a field of view of 90
degrees."""


def synthetic_episode(
    seed: int = 0, frames: int = 40, image_size: int | None = 32, miss_m: float = 0.0
) -> Episode:
    """Return an episode whose palm moves at constant speed and passes ``miss_m`` beside the
    target.
    """
    rng = np.random.default_rng(seed)
    window = max(8, frames // 5)
    arrival = window + (frames - window) // 2
    home_w = np.array([0.0, 0.0, 1.0])
    meeting = np.array([0.3, 0.1, 0.05])
    progress = np.clip((np.arange(frames) - window) / (arrival - window), 0, 1)[:, None]
    palm = progress * meeting
    velocity = rng.uniform(-0.2, 0.2, 3)
    free = np.arange(window + frames + 1)[:, None] - arrival
    passing = meeting + [0, 0, miss_m]
    speed = float(np.linalg.norm(velocity))
    path = passing + free * CONTROL_DT * velocity
    way = tuple((velocity / speed).tolist())
    motion = Constant(tuple((home_w + passing).tolist()), way, arrival * CONTROL_DT, speed, 0.0)
    target = path[np.minimum(np.arange(frames), arrival)]
    joints = progress * REFERENCE
    distance = np.linalg.norm(palm - target, axis=1)
    tips = np.maximum(distance - 0.02, 0)
    localized = np.maximum.accumulate(distance < LOCALIZATION_RADIUS_M)
    state = np.hstack([palm, joints]).astype(np.float32)
    command = np.vstack([state[1:], state[-1:]])
    images = {}
    if image_size:
        ramp = np.linspace(0, 200, image_size, dtype=np.uint8)
        ego = np.broadcast_to(ramp[None, :, None, None], (frames, image_size, image_size, 3)).copy()
        images["ego"] = ego + (np.arange(frames, dtype=np.uint8) % 50)[:, None, None, None]
    pose = np.hstack([target, np.tile([1.0, 0, 0, 0], (frames, 1))])
    meta = EpisodeMeta(
        seed=seed,
        split="train",
        motion="constant",
        category="straight_line",
        object="ball",
        parameters=motion.parameters(),
        task="Catch the moving ball.",
        agent="intercept",
        capture="attach",
        protocol="observe_before_act",
        control_class="standard",
        control_mode="joints",
        window_frames=window,
        length_frames=frames,
        intercept_frame=arrival,
        attempts=1,
        code="synthetic",
        benchmark=BENCHMARK_ID,
    )
    return Episode(
        meta=meta,
        images=images,
        state=state,
        fingertips=np.tile(state[:, :3], (1, 10)).astype(np.float32),
        phase=one_hot_phase(np.arange(frames) >= window),
        action=command,
        given_action=command,
        executed_action=command,
        target_pose_h=pose.astype(np.float32),
        target_velocity_w=np.tile(np.r_[velocity, 0, 0, 0], (frames, 1)).astype(np.float32),
        target_path_h=path.astype(np.float32),
        target_contacts=np.tile(tips[:, None] <= TOUCH_M, (1, 5)).astype(np.float32),
        palm_distance_m=distance.astype(np.float32),
        fingertip_distance_m=tips.astype(np.float32),
        localized=localized,
        captured=localized,
        intercept_pos_h=meeting.astype(np.float32),
        intercept_s=arrival * CONTROL_DT,
        home_pos_w=home_w.astype(np.float32),
        open_joints=np.zeros(15, np.float32),
        reference_joints=REFERENCE,
        **CONSTANTS,
        succeeded=next_frames(localized),
        success=bool(localized[-1]),
        stage="captured" if localized[-1] else "missed",
    )


def run_info(
    policy: str = "reach",
    *,
    command: str = "dynahoi evaluate",
    benchmark: str = BENCHMARK_ID,
    extra: dict[str, Any] | None = None,
    **recipe: Any,
) -> RunInfo:
    """Return what is told of a made-up evaluation; ``recipe`` are fields of recipe and rules."""
    played = Recipe.of(**{"split": "test"} | recipe).stored()
    return RunInfo(policy, played, command, "c1", extra or {}, benchmark)


def write_results(folder: Path, episodes: Iterable[Episode], info: RunInfo) -> Results:
    """Write a result folder of ``episodes``, in place of earlier results."""
    results = Results(folder, info).plus(list(episodes))
    results.write()
    return results
