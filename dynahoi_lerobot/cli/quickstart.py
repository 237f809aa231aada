"""``dynahoi quickstart``: dataset, training, evaluation and report on two CPU cores, in minutes.

generate -> dagger (ObAct) -> lerobot-eval -> privileged baselines -> report. Each stage writes a folder and is skipped
if that exists, so a stopped quickstart can be resumed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.foundation.arguments import path, whole
from dynahoi_lerobot.foundation.yaml_file import read_yaml
from dynahoi_lerobot.report.page import render_report
from dynahoi_lerobot.sampling.splits import SMALL_TEST

IMAGE_SIZE = 64
DATASET_EPISODES = 44
TRAINING_ROUNDS = 10
TRAINING = Path(__file__).with_suffix(".yaml")
EPISODES_PER_KIND = 2
GIFS = 6
BASELINES = ("intercept", "constant_velocity", "hold")


class StageError(RuntimeError):
    """A stage that failed; the message says which and where its output is."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi quickstart``."""
    parser.add_argument("--out", type=path, default=Path("outputs/quickstart"), help="folder for everything")
    parser.add_argument("--episodes", type=whole(1, 10**6), default=DATASET_EPISODES, help="episodes of the dataset")
    parser.add_argument("--rounds", type=whole(1, 10**6), default=TRAINING_ROUNDS, help="rounds of training")
    parser.add_argument(
        "--evaluation-episodes",
        type=whole(1, 1000),
        default=EPISODES_PER_KIND,
        help="episodes to evaluate on, of each kind",
    )


def run(args: argparse.Namespace) -> int:
    """Run the stages that are not done yet; return the exit code."""
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    stages: list[tuple[str, Path, Callable[[], None]]] = [
        ("generate a dataset", out / "dataset", lambda: _generate(out, args.episodes)),
        ("train ObAct on its own episodes", _checkpoint(out), lambda: _train(out, args.rounds)),
        ("evaluate it with lerobot-eval", out / "results" / "obact", lambda: _evaluate(out, args.evaluation_episodes)),
        ("evaluate the privileged baselines", out / "results" / BASELINES[-1], lambda: _baselines(out)),
    ]
    try:
        for number, (what, product, stage) in enumerate(stages, 1):
            _announce(number, len(stages), what, start, done=product.exists())
            if not product.exists():
                stage()
    except StageError as error:
        print(f"dynahoi quickstart: {error}", file=sys.stderr)
        return 1
    _conclude(out, start)
    return 0


def _announce(number: int, count: int, what: str, start: float, *, done: bool) -> None:
    state = "already done" if done else f"{time.monotonic() - start:.0f} s so far"
    print(f"\n[{number}/{count}] {what} ({state})", flush=True)


def _generate(out: Path, episodes: int) -> None:
    words = ["--root", str(out / "dataset"), "--episodes", str(episodes), "--image-size", str(IMAGE_SIZE)]
    if cli.main(["generate", *words, "--workers", str(os.cpu_count() or 1)]):
        raise StageError("the dataset could not be generated; the sentence above says why")


def _checkpoint(out: Path) -> Path:
    return out / "training" / "pretrained_model"


def _train(out: Path, rounds: int) -> None:
    """Train in memory, with an eye that has seen pictures before; a checkpoint is written when all rounds are done."""
    recipe = out / "training.yaml"
    values = read_yaml(TRAINING) | {"rounds": rounds, "save_every": rounds, "validate_every": rounds}
    recipe.write_text(yaml.safe_dump(values, sort_keys=False))
    if cli.main(["dagger", "--recipe", str(recipe), "--out", str(out / "training")]):
        raise StageError("training failed; the sentence above says why")


def _evaluate(out: Path, episodes_per_kind: int) -> None:
    _lerobot(
        out,
        "lerobot_eval",
        f"--policy.path={_checkpoint(out)}",
        "--policy.device=cpu",
        "--env.type=dynahoi",
        f"--env.split={SMALL_TEST}",
        f"--env.image_size={IMAGE_SIZE}",
        f"--env.results_dir={out / 'results' / 'obact'}",
        f"--eval.n_episodes={episodes_per_kind}",
        f"--eval.batch_size={episodes_per_kind}",
        "--seed=0",
        f"--output_dir={out / 'lerobot_eval'}",
    )


def _baselines(out: Path) -> None:
    """Evaluate the privileged baselines on the same episodes, and record some captures as GIFs."""
    for name in BASELINES:
        gifs = GIFS if name == "intercept" else 0
        folder = str(out / "results" / name)
        count = str(len(read_results(out / "results" / "obact").rows))
        words = ["--policy", name, "--out", folder, "--episodes", count, "--gifs", str(gifs), "--image-size", "128"]
        if cli.main(["evaluate", *words]):
            raise StageError(f"the baseline {name!r} could not be played")


def _conclude(out: Path, start: float) -> None:
    folders = [out / "results" / name for name in ("obact", *BASELINES)]
    page = render_report(folders, out / "report.html")
    table = results_table([read_results(folder) for folder in folders])
    (out / "table.txt").write_text(table + "\n")
    print(f"\n{table}\n\nThis is a few minutes of training; docs/experiments.md says what more brings.")
    print(f"everything is in {out}\nopen {page}\n{time.monotonic() - start:.0f} s")


def _lerobot(out: Path, script: str, *words: str) -> None:
    """Run one of LeRobot's commands, unchanged, and keep its output."""
    log = out / f"{script}.log"
    command = [sys.executable, "-m", f"lerobot.scripts.{script}", *words]
    print(f"{script.replace('_', '-')} {' '.join(words)}\noutput: {log}", flush=True)
    # one compute thread beside those that decode: more fight over two cores and take several times as long
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with log.open("w") as stream:
        code = subprocess.run(command, stdout=stream, stderr=subprocess.STDOUT, env=environment, check=False).returncode
    if code:
        raise StageError(f"{script.replace('_', '-')} ended with code {code}; see {log}")
