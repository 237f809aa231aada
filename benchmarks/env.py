"""Environment steps per second: the native vector env against gymnasium's over plain envs.

    python benchmarks/env.py
    python benchmarks/env.py --num-envs 1 64 --image-size 0 --rounds 4 --json FILE

Gymnasium's vector envs hold one plain env per world. Every number comes from a process of its own;
rounds take turns (A B C, A B C), so that a busy machine slows all alike. Episodes begin, end and
begin again as in evaluation; actions wander about the measured state.
"""

import argparse
import statistics
from collections import defaultdict
from collections.abc import Callable
from functools import partial

from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv
from support.isolated import measure_apart
from support.measures import wander
from support.options import benchmark_parser, parse_options, spread, write_numbers
from support.straightforward import StraightforwardEnv

from dynahoi_lerobot.env import DynahoiVectorEnv

TINY = {"num_envs": [2], "image_size": 32, "rounds": 1, "steps": 2, "env_steps": 4}


SYSTEMS = (DynahoiVectorEnv, SyncVectorEnv, AsyncVectorEnv)


def steps_per_second(
    system: Callable[..., VectorEnv], num_envs: int, image_size: int, steps: int
) -> dict[str, float]:
    """Time ``steps`` steps of one vector env."""
    if system is DynahoiVectorEnv:
        env = system(num_envs, image_size=image_size)
    else:
        env = system([partial(StraightforwardEnv, image_size)] * num_envs)
    seconds, _ = wander(env, steps)
    return {"steps_s": steps * num_envs / seconds}


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--num-envs", type=int, nargs="+", default=[1, 8, 64])
    parser.add_argument(
        "--image-size", type=int, default=128, help="side of the images [px]; 0 renders none"
    )
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument(
        "--steps",
        type=int,
        default=240,
        help="least number of vector steps in a measurement, in which most worlds begin several "
        "episodes",
    )
    parser.add_argument(
        "--env-steps", type=int, default=640, help="least number of steps of all envs together"
    )
    args = parse_options(parser, TINY)
    lines = [line for num_envs in args.num_envs for line in compare(num_envs, args)]
    write_numbers(args, lines=lines)


def compare(num_envs: int, args: argparse.Namespace) -> list[dict[str, object]]:
    """Measure the systems in turns, print and return one line each."""
    # few worlds take longer to see episodes end
    steps = max(args.steps, args.env_steps // num_envs)
    rates = defaultdict(list)
    for _ in range(args.rounds):
        for system in SYSTEMS:
            found = measure_apart(steps_per_second, system, num_envs, args.image_size, steps)
            rates[system.__name__].append(found["steps_s"])
    lines = []
    for name, own in rates.items():
        ratios = [a / b for a, b in zip(rates["DynahoiVectorEnv"], own, strict=True)]
        median = statistics.median(own)
        print(f"N={num_envs:<3} {name:18} {median:7.0f} steps/s   native / this {spread(ratios)}")
        lines.append(
            {
                "num_envs": num_envs,
                "system": name,
                "steps_s": median,
                "rates": own,
                "native_is_faster_by": statistics.median(ratios),
                "ratios": ratios,
            }
        )
    return lines


if __name__ == "__main__":
    main()
