"""Rebuild a table of learned policies in docs/results.md: generate, train and evaluate every row.

    python benchmarks/results.py
    python benchmarks/results.py --only ObAct "ACT, true state" --json docs/figures/policies.json
    python benchmarks/results.py --rows benchmarks/ablations.yaml --split val --salt SALT
    python benchmarks/results.py --dry-run

The rows name the recipes and the options that they change; benchmarks/ablations.yaml holds the
ablations. What is already in the root is not done again, so the same command resumes a run that was
stopped. The table is printed; ``--json`` replaces the rows that were run in that file.
"""

import argparse
import json
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from support.options import (
    REPOSITORY,
    benchmark_parser,
    parse_options,
    pinned_benchmark,
    provenance,
    write_numbers,
)

from dynahoi_lerobot.evaluate.checkpoint_files import folder_weights
from dynahoi_lerobot.evaluate.compare import compare
from dynahoi_lerobot.evaluate.results import WEIGHTS, Results, read_results
from dynahoi_lerobot.evaluate.table import MAIN_COLUMNS, Cell, Table, metrics_table

ROWS = Path(__file__).with_suffix(".yaml")
ENDS = {"missed": ("missed",), "touched": ("touched",), "gripped": ("enclosed", "slipped")}
"""How episodes of the contact track fail, by their stages."""
TINY = {
    "only": ["ACT, true state"],
    "split": "val",
    "episodes": 2,
    "seeds": 1,
    "generate": 4,
    "train": "--steps=2 --batch_size=2 --save_freq=2 --num_workers=0 --policy.device=cpu",
}


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        name: of the policy, as printed.
        recipe: of the training, from the root of the repository.
        dataset: name of the dataset it learns from.
        train: options that change the recipe.
        plays: name of another row, whose policies this one evaluates; it then has no recipe,
            dataset or training options of its own.
        evaluate: options of the evaluation.
        seeds: training seeds 0, 1, ..., so many.
        against: name of an earlier row, from whose seed 0 the difference in S_loc is told, paired
            by episode.
    """

    name: str
    recipe: str = ""
    dataset: str = ""
    train: str = ""
    plays: str = ""
    evaluate: str = ""
    seeds: int = 1
    against: str = ""


@dataclass(frozen=True)
class Run:
    """A row with one training seed.

    Attributes:
        name: of the row, with the seed.
        commands: in their order, by the folder that each fills.
        training: one of these folders.
        results: those of the evaluations.
        reference: name of the run from which the difference is told.
    """

    name: str
    commands: dict[Path, list[str]]
    training: Path
    results: list[Path]
    reference: str


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
    rows = {row["name"]: Row(**row) for row in table["rows"]}
    unknown = set(args.only or []) - set(rows)
    if unknown:
        parser.error(f"--only has {', '.join(sorted(unknown))}, but the rows are {', '.join(rows)}")
    results: dict[str, Results] = {}
    minutes: dict[str, float] = {}
    told: dict[str, Any] = {}
    for run in planned(rows, table["datasets"], args):
        if args.dry_run:
            print(*map(shlex.join, run.commands.values()), sep="\n")
            continue
        for folder, command in run.commands.items():
            if not done(folder).is_file():
                do(folder, command)
        spent = json.loads(done(run.training).read_text())["processor_minutes"]
        results[run.name] = pooled(run.results)
        minutes[run.name] = spent
        told[run.name] = figures(results[run.name], spent, results.get(run.reference))
    if not args.dry_run:
        print(printed(results, minutes).as_text())
        known = {}
        if args.json and args.json.exists():
            known = json.loads(args.json.read_text())["runs"]
        write_numbers(args, runs=known | told)


def planned(
    rows: dict[str, Row], datasets: dict[str, dict[str, Any]], args: argparse.Namespace
) -> list[Run]:
    """Return the runs of the chosen rows, in the order of the file.

    Args:
        rows: all of them, by name.
        datasets: by name, the ``episodes`` of each, further ``options`` of ``dynahoi generate``,
            and ``encode`` if its images are encoded.
        args: the options of this program.
    """
    runs = []
    for row in rows.values():
        if args.only is None or row.name in args.only:
            trained = rows[row.plays or row.name]
            for seed in range(args.seeds or row.seeds):
                runs.append(planned_run(row, trained, seed, datasets[trained.dataset], args))
    return runs


def planned_run(
    row: Row, trained: Row, seed: int, dataset: dict[str, Any], args: argparse.Namespace
) -> Run:
    """Return the commands of a row that plays the policies of ``trained``: dataset, training,
    evaluations.
    """
    root = args.root.resolve()
    data = root / "data" / trained.dataset
    recorded = data.with_name(f"{trained.dataset}_images") if dataset.get("encode") else data
    training = root / "training" / _slug(trained, seed)
    results = root / args.split / _slug(row, seed)
    commands = {
        recorded: [
            *("dynahoi", "generate", *shlex.split(dataset["options"])),
            *("--workers", str(args.workers)),
            *("--episodes", str(args.generate or dataset["episodes"])),
            *("--root", str(recorded)),
        ]
    }
    if recorded != data:
        commands[data] = ["dynahoi", "encode", str(recorded), str(data)]
    commands[training] = [
        "lerobot-train",
        f"--config_path={trained.recipe}",
        f"--dataset.root={data}",
        f"--output_dir={training}",
        f"--seed={seed}",
        *shlex.split(f"{trained.train} {args.train}"),
    ]
    policy = training / "checkpoints/last/pretrained_model"
    evaluate = ["dynahoi", "evaluate", "--policy", str(policy), "--split", args.split]
    if args.episodes:
        evaluate += ["--episodes", str(args.episodes)]
    evaluate += shlex.split(row.evaluate)
    evaluations = {results: [*evaluate, "--out", str(results)]}
    if args.salt:
        salted = root / f"{args.split}_salted" / results.name
        evaluations[salted] = [*evaluate, "--out", str(salted), "--salt", args.salt]
    return Run(
        f"{row.name}, seed {seed}",
        commands | evaluations,
        training,
        list(evaluations),
        f"{row.against}, seed 0",
    )


def _slug(row: Row, seed: int) -> str:
    """Return the name of a row's folders."""
    return f"{re.sub('[^a-z0-9]+', '_', row.name.lower()).strip('_')}-{seed}"


def pooled(folders: list[Path]) -> Results:
    """Return the results of one policy in several folders, each of another stream of episodes, as
    one.
    """
    first, *others = map(read_results, folders)
    for other in others:
        first = replace(first, rows=first.rows + other.rows, actions=first.actions + other.actions)
    return first


def figures(results: Results, minutes: float, reference: Results | None) -> dict[str, Any]:
    """Return what docs/figures tells of results; ``checkpoint`` is the one that ships with their
    weights.

    With a reference's results also how much higher S_loc is than theirs, paired by episode.
    """
    weights = results.info.extra[WEIGHTS]
    told: dict[str, Any] = {}
    for path in (REPOSITORY / "checkpoints").iterdir():
        if folder_weights(path) == weights:
            told["checkpoint"] = path.name
    told |= provenance()
    told |= {
        "command": results.info.command,
        "benchmark": pinned_benchmark(),
        WEIGHTS: weights,
        "minutes": minutes,
        "metrics": {name: asdict(estimate) for name, estimate in results.summary.items()},
        "by_category": {
            name: asdict(summary["S_loc"]) for name, summary in results.by("category").items()
        },
    }
    stages = Counter(row["stage"] for row in results.rows)
    for name, parts in ENDS.items():
        share = sum(stages[part] for part in parts) / stages.total()
        told["metrics"][name] = {"value": share, "unit": "fraction"}
    difference = compare(results, reference, "S_loc") if reference else None
    if difference:
        told["paired"] = asdict(difference)
    return told


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
    # the programs beside this Python, also where its environment is not on the path
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
    env = os.environ | {"PYTHONUNBUFFERED": "1", "PATH": path}
    subprocess.run(command, check=True, cwd=REPOSITORY, env=env)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    done(folder).write_text(json.dumps({"processor_minutes": round(spent_s / 60, 1)}) + "\n")


def printed(results: dict[str, Results], minutes: dict[str, float]) -> Table:
    """Return the table of results and minutes of training, both by the name of a run."""
    table = metrics_table(list(results), list(results.values()), MAIN_COLUMNS)
    rows = [
        (*row, Cell(f"{spent:.0f}", key=spent))
        for row, spent in zip(table.rows, minutes.values(), strict=True)
    ]
    return Table(table.caption, (*table.head, "min"), tuple(rows))


if __name__ == "__main__":
    main()
