"""Result folders of made-up policies that play the same synthetic episodes with different skill."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from tests.synthetic import run_info, synthetic_episode, write_results

PAIRS = [(motion.category, kind) for kind, motion in MOTIONS.items()]
LENGTHS = (32, 48, 52, 70, 96, 130)


def play(
    count: int,
    skill: float,
    capture: str = "attach",
    image_size: int | None = None,
    **meta_changes: str,
) -> Iterator[Episode]:
    """Yield ``count`` episodes; a share of about ``skill`` of them is caught."""
    for seed in range(count):
        rng = np.random.default_rng([seed, round(100 * skill)])
        miss = 0.0 if rng.random() < skill else float(rng.uniform(0.03, 0.3))
        episode = synthetic_episode(seed, LENGTHS[seed % len(LENGTHS)], image_size, miss)
        category, kind = PAIRS[seed % len(PAIRS)]
        travel = np.array([0.3, 0.1, 0.05], np.float32) * (0.1 + 0.4 * (seed % 5)) ** 1.5
        noise = rng.normal(0, 0.004 * (1.2 - skill), episode.action.shape)
        stage = episode.stage
        if capture == "contact":
            failures = ["missed", "touched", "enclosed", "slipped"]
            stage = str(rng.choice(failures)) if miss else "held"
        values = {
            "split": "test_small",
            "category": category,
            "motion": kind,
            "capture": capture,
            "action": episode.action + noise.astype(np.float32),
            "stage": stage,
            "success": not miss,
            "intercept_pos_h": episode.palm_pos_h[episode.meta.window_frames] + travel,
        }
        yield changed(episode, values | meta_changes)


def example_run(
    folder: Path,
    policy: str,
    skill: float,
    count: int = 44,
    *,
    capture: str = "attach",
    benchmark: str = BENCHMARK_ID,
    command: str = "",
    recipe: dict[str, Any] | None = None,
    **extra: object,
) -> Results:
    """Write the result folder of a made-up policy; ``recipe`` are fields of recipe and rules."""
    command = command or f"dynahoi evaluate --policy {policy} --split test_small"
    told = {"split": "test_small", "capture": capture} | (recipe or {})
    info = run_info(policy, command=command, benchmark=benchmark, extra=extra, **told)
    shown = {name: told[name] for name in ("protocol", "control_class") if name in told}
    return write_results(folder, play(count, skill, capture, benchmark=benchmark, **shown), info)
