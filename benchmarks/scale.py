"""How generation scales: with the size of the images, episodes, datatrove's tasks, and machines.

    python benchmarks/scale.py
    python benchmarks/scale.py --parts images --episodes 512 --image-sizes 96 128 256
    python benchmarks/scale.py --parts episodes --counts 100 1000 10000 --image-size 0 --json FILE
    python benchmarks/scale.py --parts tasks machines --workers 2 --tasks 8

Each dataset is made by a process of its own, from its start to statistics on disk. ``merge`` is the
share of the time in which shards are merged, without waiting for them. Two machines are two folders
that are made one after the other and merged: the time is that of the slower one and of the merge.
"""

import argparse
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from unittest import mock

from support.isolated import added, measure_apart
from support.options import benchmark_parser, parse_options, write_numbers

from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.dataset.writer import MIB
from dynahoi_lerobot.generate import executors
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan, ShardMaker
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording

TINY = {
    "episodes": 2,
    "counts": [1],
    "image_sizes": [16],
    "image_size": 16,
    "workers": 1,
    "tasks": 2,
}


def made(
    root: Path, episodes: int, image_size: int, workers: int, *, seed: int = 0, tasks: int = 0
) -> dict[str, float]:
    """Make a dataset with ``workers`` processes, as ``tasks`` of datatrove if there are any."""
    shard_episodes = max(1, min(256, episodes // max(tasks, workers)))
    recording = Recording.of(image_size=image_size)
    plan = GenerationPlan(recording, episodes, seed, shard_episodes=shard_episodes)
    play = partial(record, threads=1 if tasks or workers > 1 else 0)
    seconds: dict[str, float] = defaultdict(float)
    merge_shards = ShardMaker.merge

    def waiting(shards: Iterable[int]) -> Iterator[int]:
        following = iter(shards)
        while True:
            with added(seconds, "waiting"):
                shard = next(following, None)
            if shard is None:
                return
            yield shard

    def timed_merge(maker: ShardMaker, place: Path, shards: Iterable[int] = range(plan.shards)):
        with added(seconds, "merging"):
            return merge_shards(maker, place, waiting(shards))

    with mock.patch.object(ShardMaker, "merge", timed_merge), added(seconds, "all"):
        if tasks:
            resources = executors.ClusterResources(tasks, workers)
            executors.run("local", plan, root, play, resources)
        else:
            generate(plan, root, record=play, workers=workers)
    return {
        "frames": Manifest.read(root).frames,
        "seconds": seconds["all"],
        "merge_s": seconds["merging"] - seconds["waiting"],
        "mib": sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) / MIB,
    }


def merged(roots: list[Path], output: Path) -> dict[str, float]:
    """Merge the folders of two machines."""
    begin = time.perf_counter()
    merge(roots, output)
    return {"seconds": time.perf_counter() - begin}


def images(args: argparse.Namespace, folder: Path) -> Iterator[tuple[str, dict[str, float]]]:
    for size in args.image_sizes:
        yield (
            f"{size} px",
            measure_apart(made, folder / str(size), args.episodes, size, args.workers),
        )


def episodes(args: argparse.Namespace, folder: Path) -> Iterator[tuple[str, dict[str, float]]]:
    for count in args.counts:
        root = folder / str(count)
        yield f"{count} episodes", measure_apart(made, root, count, args.image_size, args.workers)


def tasks(args: argparse.Namespace, folder: Path) -> Iterator[tuple[str, dict[str, float]]]:
    given = (args.episodes, args.image_size)
    yield "one process", measure_apart(made, folder / "one", *given, 1)
    in_tasks = partial(made, tasks=args.tasks)
    name = f"{args.tasks} tasks, {args.workers} at once"
    yield name, measure_apart(in_tasks, folder / "tasks", *given, args.workers)


def machines(args: argparse.Namespace, folder: Path) -> Iterator[tuple[str, dict[str, float]]]:
    half = args.episodes // 2
    given = (half, args.image_size, args.workers)
    first = measure_apart(made, folder / "first", *given)
    second = measure_apart(partial(made, seed=half), folder / "second", *given)
    both = measure_apart(merged, [folder / "first", folder / "second"], folder / "both")
    yield (
        "two machines",
        {
            "frames": first["frames"] + second["frames"],
            "mib": first["mib"] + second["mib"],
            "seconds": max(first["seconds"], second["seconds"]) + both["seconds"],
            "merge_s": both["seconds"],
            "peak_mb": max(part["peak_mb"] for part in (first, second, both)),
        },
    )


PARTS = {"images": images, "episodes": episodes, "tasks": tasks, "machines": machines}


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--episodes", type=int, default=2048)
    parser.add_argument("--counts", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--image-sizes", type=int, nargs="+", default=[96, 128, 256])
    parser.add_argument(
        "--image-size", type=int, default=128, help="where the size is not what differs"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--tasks", type=int, default=8, help="of datatrove's local executor")
    args = parse_options(parser, TINY)
    print(
        "| | frames | seconds | frames/s | ms a frame | merge | largest process, MB | kB a frame |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    rows = {}
    for part in args.parts:
        with tempfile.TemporaryDirectory() as folder:
            for name, row in PARTS[part](args, Path(folder)):
                print(_line(name, row), flush=True)
                rows[name] = row
    write_numbers(args, rows=rows)


def _line(name: str, row: dict[str, float]) -> str:
    frames = row["frames"]
    seconds = row["seconds"]
    return (
        f"| {name} | {frames:.0f} | {seconds:.0f} | {frames / seconds:.0f} | "
        f"{1000 * seconds / frames:.2f} | {row['merge_s'] / seconds:.1%} | {row['peak_mb']:.0f} | "
        f"{1024 * row['mib'] / frames:.2f} |"
    )


if __name__ == "__main__":
    main()
