"""What `against.py` measures of a checkout: a program for that checkout's own Python.

    python measures.py MEASURE SETTINGS

SETTINGS are JSON, and so are the numbers that it prints. Nothing of the project is imported before
a measure begins, so that start-up counts as users see it.
"""

import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

BEGIN = time.perf_counter()
os.environ.setdefault("MUJOCO_GL", "egl")  # the fastest that needs no display
WARM_UP_STEPS = 5
WANDER = 0.01
"""Standard deviation of an action around the state [m, rad]."""
Numbers = dict[str, float]


class _FirstFrame(BaseException):
    """Ends a command once it moves a world."""


@dataclass
class Settings:
    """How large measures are.

    Attributes:
        episodes: of a generated dataset.
        processes: that generate.
        num_envs: worlds of an environment.
        steps: of it.
        image_size: side of images [px].
    """

    episodes: int = 256
    processes: int = os.cpu_count() or 1
    num_envs: int = 64
    steps: int = 240
    image_size: int = 128


def generation(settings: Settings) -> Numbers:
    """Until a world moves, imports included; then each frame, with all that is done with it."""
    from dynahoi_lerobot.generate.pipeline import generate
    from dynahoi_lerobot.generate.plan import LARGEST_SHARD, GenerationPlan
    from dynahoi_lerobot.rollout.recording import Recording

    processes = settings.processes
    shard = min(LARGEST_SHARD, -(-settings.episodes // processes))  # as in a large dataset
    recording = Recording.of(image_size=settings.image_size)
    plan = GenerationPlan(recording, settings.episodes, shard_episodes=shard)
    with tempfile.TemporaryDirectory() as folder:
        note = Path(folder) / "first step"
        record = partial(_record, note)
        before_s = _spent()[1] if processes > 1 else 0.0
        manifest = generate(plan, Path(folder) / "dataset", record=record, workers=processes)
        began_s, worker_s = (float(line) for line in note.read_text().split())
    wall_s, cpu_s = _spent()
    start_wall_s = wall_s - (time.time() - began_s)
    start_cpu_s = before_s + worker_s
    thousands = manifest.frames / 1000
    return {
        "start-up, wall s": start_wall_s,
        "start-up, CPU s of one process": start_cpu_s,
        "1,000 frames, wall s": (wall_s - start_wall_s) / thousands,
        "1,000 frames, CPU s": (cpu_s - start_cpu_s) / thousands,
        "largest process, MB": largest_process_mb(),
    }


def _record(note: Path, recording: Any, seeds: Sequence[int]) -> Iterator[Any]:
    """Record on one thread; write down when the first world moves, and what processor time its
    process has taken.
    """
    from dynahoi_lerobot.rollout import loop
    from dynahoi_lerobot.world.batch import WorldBatch

    step = WorldBatch.step

    def noting(*args: Any, **kwargs: Any) -> None:
        WorldBatch.step = step
        if not note.exists():
            note.write_text(f"{time.time()} {time.process_time()}")
        step(*args, **kwargs)

    WorldBatch.step = noting
    yield from loop.record(recording, seeds, threads=1)


def state_env(settings: Settings) -> Numbers:
    """Steps of the vector environment without images."""
    return _steps(settings, image_size=0)


def image_env(settings: Settings) -> Numbers:
    """The same with images."""
    return _steps(settings, image_size=settings.image_size)


def _steps(settings: Settings, image_size: int) -> Numbers:
    from dynahoi_lerobot.env import DynahoiVectorEnv

    env = DynahoiVectorEnv(settings.num_envs, image_size=image_size)
    wall_s, cpu_s = wander(env, settings.steps)
    thousands = settings.steps * settings.num_envs / 1000
    return {"1,000 steps, wall s": wall_s / thousands, "1,000 steps, CPU s": cpu_s / thousands}


def wander(env: Any, steps: int) -> tuple[float, float]:
    """Return wall and processor time [s] of so many steps of a vector env, whose hands wander about
    where they are; close it.
    """
    import numpy as np

    rng = np.random.default_rng(0)
    seen, _ = env.reset(seed=0)  # of the first world; the others follow
    begin = _spent()
    for step in range(-WARM_UP_STEPS, steps):
        if step == 0:
            begin = _spent()
        state = seen["agent_pos"]
        actions = (state + rng.normal(0.0, WANDER, state.shape)).astype(np.float32)
        seen = env.step(actions)[0]
    end = _spent()
    env.close()
    return end[0] - begin[0], end[1] - begin[1]


def evaluation(settings: Settings) -> Numbers:
    """Until ``dynahoi evaluate --policy pursuit --split test`` moves a world, imports included."""
    del settings
    from dynahoi_lerobot.cli.main import main
    from dynahoi_lerobot.world.batch import WorldBatch

    def step(*_: Any, **__: Any) -> None:
        raise _FirstFrame

    WorldBatch.step = step
    sys.argv = ["dynahoi", "evaluate", "--policy", "pursuit", "--split", "test"]
    try:
        main()
    except _FirstFrame:
        wall_s, cpu_s = _spent()
        return {"first frame, wall s": wall_s, "first frame, CPU s": cpu_s}
    raise RuntimeError("nothing was played")


def _spent() -> tuple[float, float]:
    """Wall time since this program began, and processor time of it and of children that have
    ended [s].
    """
    times = os.times()
    cpu_s = time.process_time() + times.children_user + times.children_system
    return time.perf_counter() - BEGIN, cpu_s


def largest_process_mb() -> float:
    """Return the most memory that this process, or a child that has ended, has held [MB]."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) / 1024


MEASURES: dict[str, Callable[[Settings], Numbers]] = {
    "generation": generation,
    "state_env": state_env,
    "image_env": image_env,
    "evaluation": evaluation,
}


if __name__ == "__main__":
    print(json.dumps(MEASURES[sys.argv[1]](Settings(**json.loads(sys.argv[2])))))
