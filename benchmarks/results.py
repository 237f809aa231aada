"""Rebuild a table of learned policies in docs/results.md: generate, train and evaluate every row,
and print it.

python benchmarks/results.py [--rows benchmarks/results.yaml] [--only "ObAct" ...] [--root
outputs/results]
    [--split test] [--episodes N] [--salt SALT] [--workers 2] [--dry-run] [--json
    docs/figures/policies.json] [--tiny]

The rows name the recipes and the options that they change; benchmarks/ablations.yaml holds the
ablations. What is already in the root is not done again, so the same command resumes a run that was
stopped. ``--json`` replaces the rows that were run in that file.
"""

import json
import os
import re
import resource
import shlex
import shutil
import subprocess
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from support.options import (
    benchmark_parser,
    parse_options,
    pinned_benchmark,
    provenance,
    write_numbers,
)

from dynahoi_lerobot.evaluate.checkpoint_files import folder_weights
from dynahoi_lerobot.evaluate.compare import compare
from dynahoi_lerobot.evaluate.results import WEIGHTS, Results, read_results
from dynahoi_lerobot.evaluate.table import MAIN_COLUMNS, metrics_table

REPOSITORY = Path(__file__).parents[1]
ROWS = Path(__file__).with_suffix(".yaml")
ENDS = {"missed": ("missed",), "touched": ("touched",), "gripped": ("enclosed", "slipped")}
"""How episodes of the contact track fail, by their stages."""
SMALLEST_TRAINING = "--steps=2 --batch_size=2 --save_freq=2 --num_workers=0 --policy.device=cpu"
TINY = {
    "only": ["ACT, true state"],
    "split": "val",
    "episodes": 2,
    "seeds": 1,
    "generate": 4,
    "train": SMALLEST_TRAINING,
}


TRAINING = "training"
"""Folder of the trainings."""


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
        against: name of an earlier row, from whose seed 0 the difference in S_loc is told, paired
            by episode.
    """

    name: str
    recipe: str
    dataset: str
    train: str = ""
    evaluate: str = ""
    seeds: int = 1
    against: str = ""


@dataclass(frozen=True)
class Plan:
    """Where everything lies, and the commands that put it there.

    Attributes:
        root: folder of datasets, trainings and results.
        datasets: by name, the episodes of each, further options of ``dynahoi generate``, and
            whether its images are encoded.
        workers: processes of that.
        split: that is evaluated.
        generate: episodes of a dataset instead of its own number; 0 for that.
        train: options added to every training.
        episodes: of the evaluation; 0 for all.
        salt: of a stream of which as many episodes are evaluated, too; empty for none.
    """

    root: Path
    datasets: dict[str, dict[str, Any]]
    workers: int
    split: str
    generate: int
    train: str
    episodes: int
    salt: str

    def commands(self, row: Row, seed: int) -> dict[Path, list[str]]:
        """Return the commands of a row in their order, each with the folder that it fills: data,
        training, results.
        """
        run = f"{re.sub('[^a-z0-9]+', '_', row.name.lower()).strip('_')}-{seed}"
        data = self.root / "data" / row.dataset
        training = self.root / TRAINING / run
        dataset = self.datasets[row.dataset]
        limit = ["--episodes", str(self.episodes)] if self.episodes else []
        options = shlex.split(f"{row.train} {self.train}")
        evaluate = [
            "dynahoi",
            "evaluate",
            "--policy",
            str(training / "checkpoints/last/pretrained_model"),
            "--split",
            self.split,
            *limit,
            *shlex.split(row.evaluate),
        ]
        results = self.root / self.split / run
        salted = self.root / f"{self.split}_salted" / run
        encoded = dataset.get("encode", False)
        recorded = data.with_name(f"{data.name}_images") if encoded else data
        generate = [
            "dynahoi",
            "generate",
            *shlex.split(dataset["options"]),
            "--workers",
            str(self.workers),
            "--episodes",
            str(self.generate or dataset["episodes"]),
            "--root",
            str(recorded),
        ]
        encode = {data: ["dynahoi", "encode", str(recorded), str(data)]} if encoded else {}
        made = {recorded: generate} | encode
        return (
            made
            | {
                training: [
                    "lerobot-train",
                    f"--config_path={row.recipe}",
                    f"--dataset.root={data}",
                    f"--output_dir={training}",
                    f"--seed={seed}",
                    *options,
                ],
                results: [*evaluate, "--out", str(results)],
            }
            | (
                {salted: [*evaluate, "--out", str(salted), "--salt", self.salt]}
                if self.salt
                else {}
            )
        )


def main() -> None:
    """Do what is missing of each row, and print the table."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--rows", type=Path, default=ROWS, help="YAML file of datasets and rows")
    parser.add_argument("--only", nargs="+", help="names of rows; all by default")
    parser.add_argument("--root", type=Path, default=Path("outputs/results"))
    parser.add_argument("--split", default="test")
    parser.add_argument(
        "--episodes", type=int, default=0, help="of each evaluation; all of the split by default"
    )
    parser.add_argument(
        "--salt", default="", help="also evaluate as many episodes of the stream with this salt"
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=0,
        help="training seeds of each row; as the file says by default",
    )
    parser.add_argument(
        "--generate",
        type=int,
        default=0,
        help="episodes of each dataset; as the file says by default",
    )
    parser.add_argument("--train", default="", help="options added to every training")
    parser.add_argument("--workers", type=int, default=2, help="processes that generate")
    parser.add_argument("--dry-run", action="store_true", help="print the commands and stop")
    args = parse_options(parser, TINY)
    table = yaml.safe_load(args.rows.read_text())
    rows = [Row(**row) for row in table["rows"]]
    if unknown := set(args.only or []) - {row.name for row in rows}:
        parser.error(
            f"--only has {', '.join(sorted(unknown))}, but the rows are "
            f"{', '.join(row.name for row in rows)}"
        )
    options = {
        name: getattr(args, name)
        for name in ("workers", "split", "generate", "train", "episodes", "salt")
    }
    plan = Plan(args.root.resolve(), table["datasets"], **options)
    runs: dict[str, Results] = {}
    minutes = {}
    against = {}
    for row in rows if args.only is None else [row for row in rows if row.name in args.only]:
        for seed in range(args.seeds or row.seeds):
            commands = plan.commands(row, seed)
            if args.dry_run:
                print(*map(shlex.join, commands.values()), sep="\n")
                continue
            for folder, command in commands.items():
                if not done(folder).is_file():
                    do(folder, command)
            (training,) = (folder for folder in commands if folder.parent.name == TRAINING)
            results = [*commands][[*commands].index(training) + 1 :]
            runs[f"{row.name}, seed {seed}"] = pooled(results)
            minutes[f"{row.name}, seed {seed}"] = json.loads(done(training).read_text())[
                "processor_minutes"
            ]
            against[f"{row.name}, seed {seed}"] = runs.get(f"{row.against}, seed 0")
    if not args.dry_run:
        print(as_markdown(runs, minutes))
        known = (
            json.loads(args.json.read_text())["runs"] if args.json and args.json.exists() else {}
        )
        told = {
            name: figures(results, minutes[name], against[name]) for name, results in runs.items()
        }
        write_numbers(args, runs=known | told)


def pooled(folders: list[Path]) -> Results:
    """Return the results of one policy in several folders, each of another stream of episodes, as
    one.
    """
    first, *others = map(read_results, folders)
    for other in others:
        first = replace(first, rows=first.rows + other.rows, actions=first.actions + other.actions)
    return first


def figures(results: Results, minutes: float, reference: Results | None = None) -> dict[str, Any]:
    """Return what docs/figures tells of results; ``checkpoint`` is the one that ships with their
    weights.

    With a reference's results also how much higher S_loc is than theirs, paired by episode.
    """
    weights = results.info.extra[WEIGHTS]
    shipped = [
        path.name
        for path in (REPOSITORY / "checkpoints").iterdir()
        if folder_weights(path) == weights
    ]
    told = {"checkpoint": shipped[0]} if shipped else {}
    by_category = {
        name: asdict(summary["S_loc"]) for name, summary in results.by("category").items()
    }
    metrics = {name: asdict(estimate) for name, estimate in results.summary.items()}
    stages = Counter(row["stage"] for row in results.rows)
    ends = {
        name: sum(map(stages.__getitem__, parts)) / stages.total() for name, parts in ENDS.items()
    }
    metrics |= {name: {"value": share, "unit": "fraction"} for name, share in ends.items()}
    difference = compare(results, reference, "S_loc") if reference else None
    paired = {"paired": asdict(difference)} if difference else {}
    ran = provenance() | {
        "command": results.info.command,
        "benchmark": pinned_benchmark(),
        WEIGHTS: weights,
    }
    return (
        told | ran | {"minutes": minutes, "metrics": metrics, "by_category": by_category} | paired
    )


def done(folder: Path) -> Path:
    """Return the file that says that a folder is complete, and how long that took."""
    return folder.with_suffix(".minutes.json")


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
    done(folder).write_text(json.dumps({"processor_minutes": round(spent_s / 60, 1)}) + "\n")


def as_markdown(runs: dict[str, Results], minutes: dict[str, float]) -> str:
    """Return the table of results and minutes of training, both by the name of a run."""
    table = metrics_table(list(runs), list(runs.values()), MAIN_COLUMNS)
    rows = [
        (*(f"{cell.text} {cell.detail}".strip() for cell in row), f"{minutes[row[0].text]:.0f}")
        for row in table.rows
    ]
    lines = [(*table.head, "min"), ("---",) * (len(table.head) + 1), *rows]
    return "\n".join([table.caption, "", *(f"| {' | '.join(line)} |" for line in lines)])


if __name__ == "__main__":
    main()
