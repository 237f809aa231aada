"""How generation scales: with the size of the images, the number of episodes, datatrove's tasks,
and with machines.

python benchmarks/scale.py [--parts images episodes tasks machines] [--episodes 2048] [--counts 100
1000 10000]
                           [--image-sizes 96 128 256] [--workers 2] [--tasks 8] [--json FILE]

Each dataset is made by a process of its own, from its start to statistics on disk. ``merge`` is the
share of the time in which shards are merged. Two machines are two folders that are made one after
the other and merged: the time is that of the slower one and of the merge.
"""

import argparse
import os
import tempfile
import time
from functools import partial
from pathlib import Path
from unittest import mock

from support.isolated import measure_apart
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.dataset.writer import MIB
from dynahoi_lerobot.generate import executors
from dynahoi_lerobot.generate.pipeline import finished, generate
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
    plan = GenerationPlan(
        Recording.of(image_size=image_size), episodes, seed, shard_episodes=shard_episodes
    )
    merge_s = 0.0
    merge_shards = ShardMaker.merge

    def merge_timed(maker: ShardMaker, place: Path):
        nonlocal merge_s
        begin = time.perf_counter()
        result = merge_shards(maker, place)
        merge_s = time.perf_counter() - begin
        return result

    begin = time.perf_counter()
    with mock.patch.object(ShardMaker, "merge", merge_timed):
        if tasks:
            executors.run(
                "local",
                plan,
                root,
                partial(record, threads=1),
                executors.ClusterResources(tasks, workers),
            )
        else:
            generate(
                plan, root, record=partial(record, threads=1 if workers > 1 else 0), workers=workers
            )
    seconds = time.perf_counter() - begin
    return {
        "frames": _frames(plan, root),
        "seconds": seconds,
        "merge_s": merge_s,
        "mib": _mib(root),
    }


def merged(roots: list[Path], output: Path) -> dict[str, float]:
    """Merge the folders of two machines."""
    begin = time.perf_counter()
    merge(roots, output)
    return {"seconds": time.perf_counter() - begin}


def images(args: argparse.Namespace, folder: Path) -> dict[str, dict[str, float]]:
    return {
        f"{size} px": measure_apart(made, folder / str(size), args.episodes, size, args.workers)
        for size in args.image_sizes
    }


def episodes(args: argparse.Namespace, folder: Path) -> dict[str, dict[str, float]]:
    return {
        f"{count} episodes": measure_apart(
            made, folder / str(count), count, args.image_size, args.workers
        )
        for count in args.counts
    }


def tasks(args: argparse.Namespace, folder: Path) -> dict[str, dict[str, float]]:
    given = (args.episodes, args.image_size)
    return {
        "one process": measure_apart(made, folder / "one", *given, 1),
        f"{args.tasks} tasks, {args.workers} at once": measure_apart(
            partial(made, tasks=args.tasks), folder / "tasks", *given, args.workers
        ),
    }


def machines(args: argparse.Namespace, folder: Path) -> dict[str, dict[str, float]]:
    half = args.episodes // 2
    roots = [folder / "first", folder / "second"]
    parts = [
        measure_apart(partial(made, seed=first), root, half, args.image_size, args.workers)
        for root, first in zip(roots, (0, half), strict=True)
    ]
    both = measure_apart(merged, roots, folder / "both")
    total = {name: sum(part[name] for part in parts) for name in ("frames", "mib")}
    seconds = max(part["seconds"] for part in parts) + both["seconds"]
    peak = max(p["peak_mb"] for p in (*parts, both))
    return {
        "two machines": total | {"seconds": seconds, "merge_s": both["seconds"], "peak_mb": peak}
    }


PARTS = {part.__name__: part for part in (images, episodes, tasks, machines)}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--episodes", type=int, default=2048)
    parser.add_argument("--counts", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--image-sizes", type=int, nargs="+", default=[96, 128, 256])
    parser.add_argument(
        "--image-size", type=int, default=128, help="where the size is not what differs"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--tasks", type=int, default=8, help="of datatrove's local executor")
    args = parser.parse_args()
    print(
        "| | frames | seconds | frames/s | ms a frame | merge | largest process, MB | kB a frame |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    rows = {}
    for part in args.parts:
        with tempfile.TemporaryDirectory() as folder:
            for name, row in PARTS[part](args, Path(folder)).items():
                print(_line(name, row), flush=True)
                rows[name] = row
    write_numbers(args, rows=rows)


def _line(name: str, row: dict[str, float]) -> str:
    frames = row["frames"]
    seconds = row["seconds"]
    rates = (
        f"{frames / seconds:.0f} | {1000 * seconds / frames:.2f} | {row['merge_s'] / seconds:.1%}"
    )
    return (
        f"| {name} | {frames:.0f} | {seconds:.0f} | {rates} | {row['peak_mb']:.0f} | "
        f"{1024 * row['mib'] / frames:.2f} |"
    )


def _frames(plan: GenerationPlan, root: Path) -> int:
    manifest = finished(plan, root)
    assert manifest is not None, "the dataset is complete"
    return manifest.frames


def _mib(root: Path) -> float:
    return sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) / MIB


if __name__ == "__main__":
    main()
