"""Environment steps per second: the native vector env against gymnasium's over one plain env per
world.

python benchmarks/env.py [--num-envs 1 8 64] [--image-size 128] [--rounds 2] [--steps 240] [--json
FILE] [--tiny]

Every number comes from a process of its own; rounds take turns (A B C, A B C), so that a busy
machine slows all alike. Episodes begin, end and begin again as in evaluation; actions wander about
the measured state.
"""

import argparse
import statistics
from functools import partial

from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv
from support.isolated import measure_apart
from support.measures import wander
from support.options import benchmark_parser, spread, write_numbers

TINY = {"num_envs": [2], "image_size": 32, "rounds": 1, "steps": 2, "env_steps": 4}


def native(num_envs: int, image_size: int) -> VectorEnv:
    from dynahoi_lerobot.env import DynahoiVectorEnv

    return DynahoiVectorEnv(num_envs, image_size=image_size)


def one_by_one(num_envs: int, image_size: int) -> VectorEnv:
    from support.straightforward import StraightforwardEnv

    return SyncVectorEnv([partial(StraightforwardEnv, image_size)] * num_envs)


def one_process_each(num_envs: int, image_size: int) -> VectorEnv:
    from support.straightforward import StraightforwardEnv

    return AsyncVectorEnv([partial(StraightforwardEnv, image_size)] * num_envs)


SYSTEMS = {
    "DynahoiVectorEnv": native,
    "SyncVectorEnv": one_by_one,
    "AsyncVectorEnv": one_process_each,
}


def steps_per_second(system: str, num_envs: int, image_size: int, steps: int) -> dict[str, float]:
    """Time ``steps`` steps of one vector env."""
    seconds, _ = wander(SYSTEMS[system](num_envs, image_size), steps)
    return {"steps_s": steps * num_envs / seconds}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
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
    args = parser.parse_args()
    lines = [line for count in args.num_envs for line in compare(count, args)]
    write_numbers(args, lines=lines)


def compare(num_envs: int, args: argparse.Namespace) -> list[dict[str, object]]:
    """Measure the systems in turns, print and return one line each."""
    steps = max(
        args.steps, args.env_steps // num_envs
    )  # few worlds take longer to see episodes end
    rounds = [
        {
            name: measure_apart(steps_per_second, name, num_envs, args.image_size, steps)
            for name in SYSTEMS
        }
        for _ in range(args.rounds)
    ]
    lines = []
    for name in SYSTEMS:
        rates = [one[name]["steps_s"] for one in rounds]
        ratios = [one["DynahoiVectorEnv"]["steps_s"] / one[name]["steps_s"] for one in rounds]
        line = {
            "num_envs": num_envs,
            "system": name,
            "steps_s": statistics.median(rates),
            "rates": rates,
        }
        lines.append(line | {"native_is_faster_by": statistics.median(ratios), "ratios": ratios})
        print(
            f"N={num_envs:<3} {name:18} {statistics.median(rates):7.0f} steps/s   native / this "
            f"{spread(ratios)}"
        )
    return lines


if __name__ == "__main__":
    main()
