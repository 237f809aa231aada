"""Motions as the sampler draws them, without the search for a home."""

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.motions import MOTIONS, Draw, Motion
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.timing import draw_timing


@dataclass(frozen=True)
class Drawn:
    """One motion and its target; when the target is to be met, and for how long the motion must make sense [s]."""

    motion: Motion
    target: TargetObject
    intercept_s: float
    horizon_s: float


def draw_motion(kind: str, seed: int, object_name: str | None = None, speed_scale: float = 1.0) -> Drawn:
    """Draw a motion of ``kind`` with the timing of a sampled episode."""
    rng = np.random.default_rng([seed, 7])
    timing = draw_timing(kind, "observe_before_act", rng)
    allowed = [name for name in BENCHMARK.splits["train"].objects if MOTIONS[kind].suits(OBJECTS[name])]
    name = object_name or str(rng.choice(allowed))
    target = OBJECTS[name].sample(rng)
    window_s = timing.window_frames * CONTROL_DT
    draw = Draw(
        rng=rng,
        target=target,
        window_s=window_s,
        intercept_s=window_s + timing.approach_frames * CONTROL_DT,
        horizon_s=(timing.window_frames + timing.length_frames) * CONTROL_DT,
        speed_scale=speed_scale,
    )
    return Drawn(MOTIONS[kind].sample(draw), target, draw.intercept_s, draw.horizon_s)
