"""Frames per second of generation, end to end: ours against the loop of a LeRobot user.

    python benchmarks/generate.py
    python benchmarks/generate.py --episodes 256 --image-size 96 --plain-episodes 8 --json FILE
    python benchmarks/generate.py --device cuda

End to end means simulated, rendered, encoded, with statistics, on disk as a LeRobotDataset. All
play the same seeds in the same scene with the same expert, on as many processes; rounds take turns
(A B C, A B C), and each measurement is a process of its own. The plain loop is measured as fast as
it can be, and with shadows and multisampling, as MuJoCo draws by default. Ours is told apart into
start-up, until the first episode is written, and the steady state after it, which is compared with
the limit of its stages: the rate at which all cores would simulate, render and encode each frame,
and do nothing else. Then the stages are measured alone, on all cores, and the shares of one process
profiled. With ``--device cuda`` pictures are drawn there (one process, all cores for physics and
the encoder).
"""

import argparse
import os
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import batched
from multiprocessing import get_context
from pathlib import Path

from support import straightforward
from support.isolated import measure_apart
from support.options import benchmark_parser, parse_options, write_numbers
from support.stages import stage_shares, stages_alone

from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan, shard_size
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.recipe import Recipe

TINY = {
    "episodes": 2,
    "plain_episodes": 1,
    "processes": 1,
    "rounds": 1,
    "image_size": 32,
    "stage_episodes": 1,
}


def ours(episodes: int, image_size: int, processes: int) -> dict[str, float]:
    """Generate a dataset as ``dynahoi generate`` does."""
    recording = Recording.of(image_size=image_size)
    plan = GenerationPlan(recording, episodes, shard_episodes=shard_size(episodes))
    play = partial(record, threads=1 if processes > 1 else 0)
    noted: list[tuple[float, int]] = []

    def note(done: int) -> None:
        if done:
            noted.append((time.perf_counter(), done))

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "dataset"
        begin = time.perf_counter()
        manifest = generate(plan, root, record=play, workers=processes, progress=note)
        end = time.perf_counter()
    started, done = noted[0]
    return {
        "frames_s": manifest.frames / (end - begin),
        "startup_s": started - begin,
        "steady_frames_s": manifest.frames * (1 - done / episodes) / (end - started),
    }


def plain(
    episodes: int, image_size: int, processes: int, *, shadows: bool = False
) -> dict[str, float]:
    """Record the same seeds with one plain env and one LeRobotDataset per process."""
    recipe = Recipe.of(image_size=image_size)
    seeds = list(batched(range(episodes), -(-episodes // processes)))
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(processes, get_context("spawn")) as pool,
    ):
        roots = [Path(folder) / str(k) for k in range(len(seeds))]
        play = partial(_record_plainly, recipe, shadows)
        frames, seconds = zip(*pool.map(play, roots, seeds), strict=True)
    return {"frames_s": sum(frames) / max(seconds)}


def _record_plainly(
    recipe: Recipe, shadows: bool, root: Path, seeds: tuple[int, ...]
) -> tuple[int, float]:
    """Return frames and seconds; imports do not count, as fewer episodes have to carry them than in
    ours.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # the encoder reports on every episode
    from lerobot.datasets import lerobot_dataset  # noqa: F401

    begin = time.perf_counter()
    frames = straightforward.record(root, recipe, seeds, shadows=shadows)
    return frames, time.perf_counter() - begin


SYSTEMS = {"ours": ours, "plain": plain, "plain_shadows": partial(plain, shadows=True)}


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--episodes", type=int, default=2048)
    parser.add_argument("--image-size", type=int, default=128)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument(
        "--processes", type=int, default=os.cpu_count(), help="of either system on the CPU"
    )
    parser.add_argument("--plain-episodes", type=int, default=24, help="episodes of the plain loop")
    parser.add_argument(
        "--stage-episodes", type=int, default=96, help="episodes in which stages are measured"
    )
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    args = parse_options(parser, TINY)
    if args.device == "cpu":
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
    else:
        args.processes = 1
    rounds = compare(args)
    alone = stages_alone(args.image_size)
    shares = stage_shares(args.image_size, args.stage_episodes)
    _print_stages(alone, shares)
    limit = 1 / sum(1 / rate for rate in alone.values())
    steady = statistics.median(r["ours_steady_frames_s"] for r in rounds)
    print(
        f"steady state {steady:.0f} frames/s, limit of the stages {limit:.0f} frames/s: "
        f"{steady / limit:.2f} of it"
    )
    write_numbers(
        args,
        rounds=rounds,
        alone=alone,
        shares=shares,
        limit_frames_s=limit,
        share_of_limit=steady / limit,
    )


def compare(args: argparse.Namespace) -> list[dict[str, float]]:
    """Measure all systems in turns, print a line for each, then the ratios."""
    rounds = []
    for _ in range(args.rounds):
        line = {}
        for name, system in SYSTEMS.items():
            episodes = args.episodes if name == "ours" else args.plain_episodes
            result = measure_apart(system, episodes, args.image_size, args.processes)
            print(name, *(f" {key} {value:.2f}" for key, value in result.items()), flush=True)
            line |= {f"{name}_{key}": value for key, value in result.items()}
        rounds.append(line)
    for name in ("plain", "plain_shadows"):
        ratios = [line["ours_frames_s"] / line[f"{name}_frames_s"] for line in rounds]
        print(f"ours against {name}, median of {len(rounds)}: {statistics.median(ratios):.2f}")
    return rounds


def _print_stages(alone: dict[str, float], shares: dict[str, float]) -> None:
    for name, share in shares.items():
        rate = f", alone {alone[name]:7.0f} frames/s" if name in alone else ""
        print(f"{name:12} {share:6.1%} of one process{rate}")


if __name__ == "__main__":
    main()
