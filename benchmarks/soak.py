"""Hours of misuse in minutes: random and bad actions through the vector env, decisions against a hostile server.

python benchmarks/soak.py [--episodes 2000] [--num-envs 16] [--decisions 300] [--json FILE] [--tiny]

Every step draws actions at random; one in ten is bad (not finite, of a wrong shape or element type) and must be refused
with a ValueError while the worlds go on, and now and then all episodes are begun anew. Then eight threads ask a local
server that behaves badly in every way that the tests know. Memory is sampled all the time; anything unexpected that is
raised is counted by its type.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from support.options import benchmark_parser, write_numbers

sys.path.insert(0, str(Path(__file__).parents[1]))  # the hostile server is part of the tests

TINY = {"episodes": 4, "num_envs": 2, "decisions": 8, "bad_every": 3, "reset_every": 40}
WANDER = 0.2
"""Standard deviation of an action around the state [m, rad]."""
THREADS = 8
TIMEOUT_S = 0.5
"""For one decision with its retry [s]."""
SAMPLES = 20
"""Lines of a printed memory curve."""

BAD_ACTIONS: dict[str, Callable[[np.ndarray], Any]] = {
    "NaN": lambda good: np.where(np.arange(good.shape[-1]) == 3, np.nan, good),
    "infinite": lambda good: np.where(np.arange(good.shape[-1]) == 0, np.inf, good),
    "one world too few": lambda good: good[:-1],
    "one joint too many": lambda good: np.concatenate([good, good[:, :1]], axis=1),
    "flat": lambda good: good.ravel(),
    "empty": lambda good: np.empty((0, good.shape[-1]), np.float32),
    "text": lambda good: good.astype(str),
    "objects": lambda good: np.full(good.shape, None),
    "complex": lambda good: good.astype(complex),
    "dates": lambda good: np.zeros(good.shape, "datetime64[s]"),
    "none": lambda good: None,
}
"""Actions that no step may accept, made from good ones (N, 18)."""


class Memory:
    """Resident memory of this process over the units of work that are done."""

    def __init__(self) -> None:
        self.curve: list[tuple[int, float]] = []

    def sample(self, done: int) -> None:
        """Add the resident memory [MB] now."""
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.curve.append((done, pages * os.sysconf("SC_PAGE_SIZE") / 1e6))

    def report(self) -> dict[str, Any]:
        """Return the curve and what the second half of the work added [MB]."""
        levels = [level for _, level in self.curve]
        half = len(levels) // 2
        return {"curve_mb": self.curve, "peak_mb": max(levels), "second_half_mb": levels[-1] - levels[half]}


def soak_env(args: argparse.Namespace) -> dict[str, Any]:
    """Play episodes with random actions, resets and bad actions."""
    from dynahoi_lerobot.env import DynahoiVectorEnv

    ended = 0

    def count(_: object) -> None:
        nonlocal ended
        ended += 1

    env = DynahoiVectorEnv(args.num_envs, split="train", images=False, on_episode=count)
    rng, memory, begin, step = np.random.default_rng(0), Memory(), time.monotonic(), 0
    refused, unexpected = Counter[str](), Counter[str]()
    state = env.reset(seed=0)[0]["agent_pos"]
    while ended < args.episodes:
        step += 1
        good = (state + rng.normal(0.0, WANDER, state.shape)).astype(np.float32)
        if step % args.bad_every == 0:
            name = str(rng.choice(list(BAD_ACTIONS)))
            _refuse(env, name, BAD_ACTIONS[name](good), refused, unexpected)
        if step % args.reset_every == 0:
            env.reset()
        state = env.step(good)[0]["agent_pos"]
        if not np.isfinite(state).all():
            unexpected["a state is not finite"] += 1
        if step % 50 == 0 or ended >= args.episodes:
            memory.sample(ended)
    env.close()
    played = {"episodes": ended, "steps": step * args.num_envs, "seconds": time.monotonic() - begin}
    return played | {"refused": dict(refused), "unexpected": dict(unexpected), **memory.report()}


def _refuse(env: Any, name: str, action: Any, refused: Counter[str], unexpected: Counter[str]) -> None:
    """Count a bad action as refused, or what happened instead."""
    try:
        env.step(action)
    except ValueError:
        refused[name] += 1
    except Exception as error:  # what else there may be is what is looked for
        unexpected[f"{name}: {type(error).__name__}"] += 1
    else:
        unexpected[f"{name}: accepted"] += 1


def soak_vlm(args: argparse.Namespace) -> dict[str, Any]:
    """Ask a server that behaves badly in every way in turn."""
    from dynahoi_lerobot.vlm.client import VlmClient
    from tests.vlm.hostile import KEY, STATE

    os.environ["OPENAI_API_KEY"] = KEY
    memory, unexpected, begin = Memory(), Counter[str](), time.monotonic()
    image = np.zeros((32, 32, 3), np.uint8)

    def decide(_: int) -> bool:
        try:
            return client.plan("Catch it.", STATE, image) is not None
        except Exception as error:  # what else there may be is what is looked for
            unexpected[type(error).__name__] += 1
            return False
        finally:
            memory.sample(len(memory.curve) + 1)

    with hostile_server() as url, ThreadPoolExecutor(THREADS) as pool:
        client = VlmClient("tiny", url, timeout_s=TIMEOUT_S, retries=1)
        usable = sum(pool.map(decide, range(args.decisions)))
    report = client.report() | {"usable": usable, "seconds": time.monotonic() - begin}
    return report | {"unexpected": dict(unexpected), **memory.report()}


@contextmanager
def hostile_server() -> Iterator[str]:
    """Serve in a process of its own, which keeps every request, so that the memory measured is the client's."""
    here, there = (context := multiprocessing.get_context("spawn")).Pipe()
    server = context.Process(target=_serve, args=(there,), daemon=True)
    server.start()
    try:
        yield here.recv()
    finally:
        server.kill()
        server.join()


def _serve(pipe: Connection) -> None:
    from tests.vlm.hostile import in_turn
    from tests.vlm.server import serving

    with serving(in_turn()) as (url, _):
        pipe.send(url)
        threading.Event().wait()


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--bad-every", type=int, default=10, help="steps between two bad actions")
    parser.add_argument("--reset-every", type=int, default=500, help="steps between two resets")
    parser.add_argument("--decisions", type=int, default=300)
    args = parser.parse_args()
    results = {}
    for name, soak in (("env", soak_env), ("vlm", soak_vlm)):
        results[name] = soak(args)
        show(name, results[name])
    write_numbers(args, **results)
    if any(result["unexpected"] for result in results.values()):
        sys.exit("something unexpected was raised; see above")


def show(name: str, result: dict[str, Any]) -> None:
    """Print the counts, then the memory curve."""
    for key, value in result.items():
        if key != "curve_mb":
            print(f"{name:4} {key}: {value:.1f}" if isinstance(value, float) else f"{name:4} {key}: {value}")
    curve = result["curve_mb"]
    for done, level in curve[:: max(1, len(curve) // SAMPLES)]:
        print(f"{name:4} after {done:5}: {level:7.1f} MB", flush=True)


if __name__ == "__main__":
    main()
