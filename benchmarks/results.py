"""Rebuild the table of learned policies in docs/results.md: generate, train and evaluate every row, and print it.

python benchmarks/results.py [--rows benchmarks/results.yaml] [--only "ObAct" ...] [--root outputs/results]
    [--split test] [--episodes N] [--workers 2] [--dry-run] [--json FILE] [--tiny]

The rows name the recipes and the options that they change. What is already in the root is not done again, so the same
command resumes a run that was stopped.
"""

from __future__ import annotations

import json
import os
import re
import resource
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

import yaml
from support.options import benchmark_parser, write_numbers

REPOSITORY = Path(__file__).parents[1]
ROWS = Path(__file__).with_suffix(".yaml")
PERCENT = ("S_loc", "S_joint", "S_gra_two_sided", "S_gra")
SCORES = ("E_loc", "E_gra", "Q_smooth", "Q_line", "R_time")
SMALLEST_TRAINING = "--steps=2 --batch_size=2 --save_freq=2 --num_workers=0 --policy.device=cpu"
TINY = {
    "only": ["ACT, true state"],
    "split": "val",
    "episodes": 2,
    "seeds": 1,
    "generate": 4,
    "train": SMALLEST_TRAINING,
}
DONE = "minutes.json"
NONE = "–"


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        name: of the policy, as printed.
        recipe: of the training, from the root of the repository.
        dataset: name of the dataset it learns from.
        train: options that change the recipe.
        evaluate: options of the evaluation.
        seeds: training seeds 0, 1, ..., so many.
    """

    name: str
    recipe: str
    dataset: str
    train: str = ""
    evaluate: str = ""
    seeds: int = 1


@dataclass(frozen=True)
class Plan:
    """Where everything lies, and the commands that put it there.

    Attributes:
        root: folder of datasets, trainings and results.
        datasets: options of ``dynahoi generate`` by name.
        workers: processes of that.
        split: that is evaluated.
        generate: episodes of a dataset instead of its own number; 0 for that.
        train: options added to every training.
        episodes: of the evaluation; 0 for all.
    """

    root: Path
    datasets: dict[str, str]
    workers: int
    split: str
    generate: int
    train: str
    episodes: int

    def commands(self, row: Row, seed: int) -> dict[Path, list[str]]:
        """Return the commands of a row in their order, each with the folder that it fills."""
        run = f"{re.sub('[^a-z0-9]+', '_', row.name.lower()).strip('_')}-{seed}"
        data, training = self.root / "data" / row.dataset, self.root / "training" / run
        generate = self.datasets[row.dataset]
        if self.generate:
            generate = re.sub(r"--episodes \d+", f"--episodes {self.generate}", generate)
        limit = ["--episodes", str(self.episodes)] if self.episodes else []
        options = shlex.split(f"{row.train} {self.train}")
        return {
            data: ["dynahoi", "generate", *shlex.split(generate), "--workers", str(self.workers), "--root", str(data)],
            training: ["lerobot-train", f"--config_path={row.recipe}", f"--dataset.root={data}",
                       f"--output_dir={training}", f"--seed={seed}", *options],
            self.root / self.split / run: [
                "dynahoi", "evaluate", "--policy", str(training / "checkpoints/last/pretrained_model"),
                "--split", self.split, "--out", str(self.root / self.split / run), *limit, *shlex.split(row.evaluate)],
        }  # fmt: skip


def main() -> None:
    """Do what is missing of each row, and print the table."""
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--rows", type=Path, default=ROWS, help="YAML file of datasets and rows")
    parser.add_argument("--only", nargs="+", help="names of rows; all by default")
    parser.add_argument("--root", type=Path, default=Path("outputs/results"))
    parser.add_argument("--split", default="test")
    parser.add_argument("--episodes", type=int, default=0, help="of each evaluation; all of the split by default")
    parser.add_argument("--seeds", type=int, default=0, help="training seeds of each row; as the file says by default")
    parser.add_argument("--generate", type=int, default=0, help="episodes of each dataset; as the file says by default")
    parser.add_argument("--train", default="", help="options added to every training")
    parser.add_argument("--workers", type=int, default=2, help="processes that generate")
    parser.add_argument("--dry-run", action="store_true", help="print the commands and stop")
    args = parser.parse_args()
    table = yaml.safe_load(args.rows.read_text())
    rows = [Row(**row) for row in table["rows"]]
    if unknown := set(args.only or []) - {row.name for row in rows}:
        parser.error(f"--only has {', '.join(sorted(unknown))}, but the rows are {', '.join(row.name for row in rows)}")
    plan = Plan(
        args.root.resolve(), table["datasets"], args.workers, args.split, args.generate, args.train, args.episodes
    )
    numbers = {}
    for row in rows:
        if args.only and row.name not in args.only:
            continue
        runs = [plan.commands(row, seed) for seed in range(args.seeds or row.seeds)]
        if args.dry_run:
            print(*(shlex.join(command) for run in runs for command in run.values()), sep="\n")
        else:
            numbers[row.name] = [measured(run) for run in runs]
    if not args.dry_run:
        print(as_markdown(numbers))
        write_numbers(args, rows=numbers)


def measured(commands: dict[Path, list[str]]) -> dict[str, Any]:
    """Run what has not been run, and return the metrics of the result, the minutes of training and the parameters."""
    for folder, command in commands.items():
        if not (folder.with_suffix(f".{DONE}")).is_file():
            do(folder, command)
    _, training, result = commands
    metrics = json.loads((result / "metrics.json").read_text())["metrics"]
    minutes = json.loads(training.with_suffix(f".{DONE}").read_text())["processor_minutes"]
    return metrics | {"minutes": minutes}


def do(folder: Path, command: list[str]) -> None:
    """Run a command and note how long it took, in processor minutes of all its processes."""
    last = folder / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    if command[0] == "lerobot-train" and last.is_file():
        command = ["lerobot-train", f"--config_path={last}", "--resume=true"]
    elif command[0] == "lerobot-train":
        shutil.rmtree(folder, ignore_errors=True)
    print(shlex.join(command), flush=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, cwd=REPOSITORY, env=os.environ | {"PYTHONUNBUFFERED": "1"})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    folder.with_suffix(f".{DONE}").write_text(json.dumps({"processor_minutes": round(spent_s / 60, 1)}) + "\n")


def as_markdown(numbers: dict[str, list[dict[str, Any]]]) -> str:
    """Return the table; a row of several training seeds shows their mean and, for S_loc, each of them."""
    lines = [
        "| | S_loc | S_joint | " + " | ".join([*PERCENT[2:], "E_loc [u]", "E_gra [u]", *SCORES[2:], "min"]) + " |",
        "|---" * (len(PERCENT) + len(SCORES) + 2) + "|",
    ]
    for name, runs in numbers.items():
        cells = [percent(runs, metric, metric in PERCENT[:2]) for metric in PERCENT]
        cells += [score(runs, metric) for metric in SCORES]
        cells.append(f"{mean(run['minutes'] for run in runs):.0f}")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def percent(runs: list[dict[str, Any]], metric: str, detailed: bool) -> str:
    """Return a rate in %, with its interval, or with the rates of all training seeds."""
    values = values_of(runs, metric, 100)
    if not values:
        return NONE
    if not detailed:
        return f"{mean(values):.1f}"
    if len(values) > 1:
        return f"{mean(values):.1f} ({', '.join(f'{value:.1f}' for value in values)})"
    return f"{values[0]:.1f} [{100 * runs[0][metric]['low']:.1f}, {100 * runs[0][metric]['high']:.1f}]"


def score(runs: list[dict[str, Any]], metric: str) -> str:
    """Return the mean of a score."""
    values = values_of(runs, metric)
    return f"{mean(values):.2f}" if values else NONE


def values_of(runs: list[dict[str, Any]], metric: str, unit: float = 1) -> list[float]:
    """Return the values of a metric, times ``unit``, in the runs that have any episode to which it applies."""
    return [unit * run[metric]["value"] for run in runs if run[metric]["value"] is not None]


if __name__ == "__main__":
    main()
