"""Train and evaluate every variant of a study under one protocol, and report them together.

    python recipes/study/run.py recipes/study/cpu.yaml --out outputs/study

Variants run one after another through ``lerobot-train`` and ``dynahoi evaluate``, and the report grows with each; those
that are done are skipped, so the same command goes on after an interruption. Each result folder says what the variant
was (``extra`` in ``metrics.json``), which is what the report's figures on observed frames and data scaling read.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
PACE_STEPS = (50, 250)
"""The steps of two short runs, whose difference in time says how long a step takes."""
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}


@dataclass(frozen=True)
class Variant:
    """One row of the study.

    Attributes:
        name: of its folder.
        config: a training recipe, relative to the repository.
        options: what it changes, as ``lerobot-train`` options.
        data_fraction: share of the episodes it learns from, the first ones.
        as_long_as: another variant, whose training time this one gets instead of its number of steps.
        extra: what its results say about it.
    """

    name: str
    config: str
    options: dict[str, Any] = field(default_factory=dict)
    data_fraction: float = 1.0
    as_long_as: str = ""
    extra: dict[str, Any] = field(default_factory=dict)


def main() -> None:
    """Run the study that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("--out", type=Path, default=Path("outputs/study"))
    parser.add_argument("--data", type=Path, help="training data; generated in OUT by default")
    parser.add_argument("--only", help="comma-separated names of variants")
    args = parser.parse_args()
    study = yaml.safe_load(args.study.read_text())
    variants = [Variant(**{**study["defaults"], **row}) for row in study["variants"]]
    if args.only:
        variants = [variant for variant in variants if variant.name in args.only.split(",")]
    data = args.data or generate(study["data"], args.out)
    for name in study["baselines"]:
        for split in study["splits"]:
            play(name, split, args.out / "results" / f"{name}-{split}", study["image_size"])
    for variant in variants:
        train(variant, study["common"], data, args.out / variant.name)
        for split in study["splits"]:
            evaluate(variant, split, args.out / variant.name, study["image_size"])
        folders = sorted((args.out / "results").iterdir())
        dynahoi("report", *map(str, folders), "--out", str(args.out / "report.html"))


def generate(data: dict[str, Any], out: Path) -> Path:
    """Write what is still missing of the training data; return the copy to train on, which is faster to read."""
    full, lean, partial = out / "data", out / "data_lean", out / "data_lean.partial"
    what = ["--recipe", str(ROOT / data["recipe"]), "--episodes", str(data["episodes"])]
    dynahoi("generate", *what, "--workers", str(os.cpu_count() or 1), "--root", str(full))
    if not lean.exists():
        shutil.rmtree(partial, ignore_errors=True)
        which = [f"--config_path={ROOT / 'recipes/lean.yaml'}", f"--root={full}", f"--new_root={partial}"]
        run([sys.executable, "-m", "lerobot.scripts.lerobot_edit_dataset", *which], lean.with_suffix(".log"))
        partial.rename(lean)
    return lean


def train(variant: Variant, common: dict[str, Any], data: Path, out: Path) -> None:
    """Train one variant unless its last checkpoint is there."""
    if checkpoint(out).exists():
        return
    options = {**common, "dataset.root": data, **variant.options}
    if variant.data_fraction < 1:
        episodes = json.loads((data / "meta" / "info.json").read_text())["total_episodes"]
        options["dataset.episodes"] = list(range(round(variant.data_fraction * episodes)))
    if variant.as_long_as:
        seconds = json.loads((out.parent / variant.as_long_as / "seconds.json").read_text())
        options["steps"] = steps_within(seconds, variant, options, out)
    seconds = lerobot_train(variant, options, out / "training")
    (out / "seconds.json").write_text(json.dumps(round(seconds)))


def steps_within(seconds: float, variant: Variant, options: dict[str, Any], out: Path) -> int:
    """Return how many steps of a variant take ``seconds``, start-up included, on this machine."""
    few, more = PACE_STEPS
    short = {**options, "save_checkpoint": False}
    took = {steps: lerobot_train(variant, {**short, "steps": steps}, out / f"pace_{steps}") for steps in PACE_STEPS}
    step = (took[more] - took[few]) / (more - few)
    return max(1, round(few + (seconds - took[few]) / step))


def lerobot_train(variant: Variant, options: dict[str, Any], out: Path) -> float:
    """Train into ``out``, with a log beside it, from the start; return how long it took [s]."""
    shutil.rmtree(out, ignore_errors=True)  # of a run that was interrupted
    where = [f"--config_path={ROOT / variant.config}", f"--output_dir={out}"]
    start = time.monotonic()
    run([sys.executable, "-m", "lerobot.scripts.lerobot_train", *where, *words(options)], out.with_suffix(".log"))
    return time.monotonic() - start


def words(options: dict[str, Any]) -> list[str]:
    """Return options as LeRobot reads them from a command line."""
    return [f"--{key}={json.dumps(value, default=str).strip(chr(34))}" for key, value in options.items()]


def evaluate(variant: Variant, split: str, out: Path, image_size: int) -> None:
    """Evaluate one trained variant on a split, and write down what it was, which says that all was played."""
    folder = out.parent / "results" / f"{variant.name}-{split}"
    path = folder / "metrics.json"
    if path.exists() and json.loads(path.read_text())["policy"] == variant.name:
        return
    play(str(checkpoint(out)), split, folder, image_size)
    head = json.loads(path.read_text())
    head["policy"] = variant.name
    seconds = json.loads((out / "seconds.json").read_text())
    head["extra"] |= {**variant.extra, "data_fraction": variant.data_fraction, "training_seconds": seconds}
    path.write_text(json.dumps(head, indent=2) + "\n")


def play(policy: str, split: str, folder: Path, image_size: int) -> None:
    """Play what has not been played of a split."""
    what = ["--policy", policy, "--split", split, "--image-size", str(image_size)]
    dynahoi("evaluate", *what, "--out", str(folder))


def checkpoint(out: Path) -> Path:
    """Return where the last checkpoint of a variant is."""
    return out / "training" / "checkpoints" / "last" / "pretrained_model"


def dynahoi(*arguments: str) -> None:
    """Run one of our commands."""
    run([sys.executable, "-m", "dynahoi_lerobot.cli.main", *arguments])


def run(command: list[str], log: Path | None = None) -> None:
    """Run a command, into a log if one is given; stop the study if it fails."""
    print(" ".join(command[2:]), flush=True)
    if log is None:
        subprocess.run(command, env=ENVIRONMENT, check=True)
        return
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w") as stream:
        subprocess.run(command, env=ENVIRONMENT, check=True, stdout=stream, stderr=subprocess.STDOUT)


if __name__ == "__main__":
    main()
