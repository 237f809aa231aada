"""Train and evaluate every variant of a study under one protocol, and report them together.

    python recipes/study/run.py recipes/study/cpu.yaml --out outputs/study
    python recipes/study/run.py recipes/study/observing.yaml --out outputs/observing

Variants run one after another through ``lerobot-train`` or ``dynahoi dagger``, and then ``dynahoi evaluate``; the
report grows with each. Those that are done are skipped, so the same command goes on after an interruption. With
``--seeds 0 1 2`` every variant is trained once with each of these seeds. Each result folder says what the variant was
(``extra`` in ``metrics.json``), which is what the report's figures on observed frames and data scaling read.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
PACE_STEPS = (50, 250)
"""The steps of two short runs, whose difference in time says how long a step takes."""
AS_IT_IS = "as_it_is"
"""The condition of studies that name none: nothing about the evaluation is changed."""
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}


@dataclass(frozen=True)
class Variant:
    """One row of the study.

    Attributes:
        name: of its folder.
        config: a training recipe, relative to the repository.
        trainer: ``lerobot-train``, or ``dagger``, which learns in memory and reads recipes of ``dynahoi dagger``.
        options: what it changes of the recipe, by dotted names.
        conditions: names of the study's conditions that it is evaluated under.
        data_fraction: share of the episodes it learns from, the first ones.
        as_long_as: another variant, whose training time this one gets instead of its number of steps.
        times: so many times that time.
        extra: what its results say about it.
    """

    name: str
    config: str
    trainer: str = "lerobot-train"
    options: dict[str, Any] = field(default_factory=dict)
    conditions: list[str] = field(default_factory=lambda: [AS_IT_IS])
    data_fraction: float = 1.0
    as_long_as: str = ""
    times: float = 1.0
    extra: dict[str, Any] = field(default_factory=dict)


def main() -> None:
    """Run the study that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("--out", type=Path, default=Path("outputs/study"))
    parser.add_argument("--data", type=Path, help="training data; generated in OUT by default")
    parser.add_argument("--only", help="comma-separated names of variants")
    parser.add_argument("--seeds", type=int, nargs="+", help="of the trainings; that of the recipe by default")
    parser.add_argument("--splits", nargs="+", help="to evaluate on; those of the study by default")
    args = parser.parse_args()
    study = yaml.safe_load(args.study.read_text())
    study["splits"] = args.splits or study["splits"]
    variants = [Variant(**{**study["defaults"], **row}) for row in study["variants"]]
    if args.only:
        variants = [variant for variant in variants if variant.name in args.only.split(",")]
    if args.seeds:
        variants = [seeded(variant, seed) for variant in variants for seed in args.seeds]
    data = (args.data or generate(study["data"], args.out)) if "data" in study else None
    conditions = study.get("conditions", {AS_IT_IS: {}})
    for name in study["baselines"]:
        for split in study["splits"]:
            play(name, args.out / "results" / f"{name}-{split}", {"split": split, "image-size": study["image_size"]})
    for variant in variants:
        train(variant, study.get("common", {}), data, args.out / variant.name)
        for split in study["splits"]:
            for condition in variant.conditions:
                how = {"split": split, "image-size": study["image_size"], **conditions[condition]}
                evaluate(variant, condition, how, args.out / variant.name)
        folders = sorted((args.out / "results").iterdir())
        dynahoi("report", *map(str, folders), "--out", str(args.out / "report.html"))


def seeded(variant: Variant, seed: int) -> Variant:
    """Return a variant that is trained with another seed."""
    return replace(
        variant,
        name=f"{variant.name}_seed{seed}",
        as_long_as=f"{variant.as_long_as}_seed{seed}" if variant.as_long_as else "",
        options={**variant.options, "seed": seed},
        extra={**variant.extra, "training_seed": seed},
    )


def generate(data: dict[str, Any], out: Path) -> Path:
    """Write what is still missing of the training data, with options of ``dynahoi generate``; return its folder."""
    root = out / "data"
    what = {**data, "recipe": ROOT / data["recipe"], "workers": os.cpu_count() or 1, "root": root}
    dynahoi("generate", *repeated(what))
    return root


def train(variant: Variant, common: dict[str, Any], data: Path | None, out: Path) -> None:
    """Train one variant unless its last checkpoint is there."""
    if (out / "seconds.json").exists():
        return
    out.mkdir(parents=True, exist_ok=True)
    if variant.trainer == "dagger":
        seconds = dagger(variant, common, out)
    else:
        assert data is not None, f"{variant.name} learns from data, and the study has none"
        seconds = train_on_data(variant, common, data, out)
    (out / "seconds.json").write_text(json.dumps(round(seconds)))


def dagger(variant: Variant, common: dict[str, Any], out: Path) -> float:
    """Train in memory, or go on with that; return the processor time it took in all [s]."""
    path, folder = out / "recipe.yaml", out / "training"
    recipe = changed(yaml.safe_load((ROOT / variant.config).read_text()), {**common, **variant.options})
    path.write_text(yaml.safe_dump(recipe, sort_keys=False))
    dynahoi("dagger", "--recipe", str(path), "--out", str(folder))
    return 60 * json.loads((folder / "log.jsonl").read_text().splitlines()[-1])["processor_minutes"]


def changed(recipe: dict[str, Any], options: dict[str, Any]) -> dict[str, Any]:
    """Return a recipe with values changed that dotted names tell."""
    for name, value in options.items():
        owner, _, key = name.rpartition(".")
        recipe = {**recipe, owner: {**recipe[owner], key: value}} if owner else {**recipe, key: value}
    return recipe


def train_on_data(variant: Variant, common: dict[str, Any], data: Path, out: Path) -> float:
    """Train on a dataset through LeRobot; return how long it took [s]."""
    options = {**common, "dataset.root": data, **variant.options}
    if variant.data_fraction < 1:
        episodes = json.loads((data / "meta" / "info.json").read_text())["total_episodes"]
        options["dataset.episodes"] = list(range(round(variant.data_fraction * episodes)))
    if variant.as_long_as:
        seconds = variant.times * json.loads((out.parent / variant.as_long_as / "seconds.json").read_text())
        options["steps"] = steps_within(seconds, variant, options, out)
    return lerobot_train(variant, options, out / "training")


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


def evaluate(variant: Variant, condition: str, how: dict[str, Any], out: Path) -> None:
    """Evaluate one trained variant under a condition, and write down what it was, which says that all was played."""
    folder = out.parent / "results" / "-".join([variant.name, how["split"], condition])
    path = folder / "metrics.json"
    if path.exists() and json.loads(path.read_text())["policy"] == variant.name:
        return
    play(str(checkpoint(variant, out)), folder, how)
    head = json.loads(path.read_text())
    head["policy"] = variant.name
    seconds = json.loads((out / "seconds.json").read_text())
    head["extra"] |= {**variant.extra, "data_fraction": variant.data_fraction, "training_seconds": seconds}
    head["extra"] |= {"condition": condition}
    path.write_text(json.dumps(head, indent=2) + "\n")


def play(policy: str, folder: Path, how: dict[str, Any]) -> None:
    """Play what has not been played, with options of ``dynahoi evaluate``."""
    dynahoi("evaluate", "--policy", policy, *repeated(how), "--out", str(folder))


def repeated(options: dict[str, Any]) -> list[str]:
    """Return options as our commands read them; each entry of a list is an option of its own, and ``true`` a flag."""
    flat = [(name, one) for name, value in options.items() for one in (value if isinstance(value, list) else [value])]
    return [word for name, value in flat for word in ([f"--{name}"] if value is True else [f"--{name}", str(value)])]


def checkpoint(variant: Variant, out: Path) -> Path:
    """Return where the last checkpoint of a variant is."""
    if variant.trainer == "dagger":
        return out / "training" / "pretrained_model"
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
