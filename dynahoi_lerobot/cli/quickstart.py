"""``dynahoi quickstart``: dataset, training, evaluation and report, in minutes on two CPU cores.

generate -> encode -> lerobot-train (ObAct) -> lerobot-eval -> report. The privileged baselines,
which need no checkpoint, are evaluated beside the training, which leaves a core idle. A stage is
skipped if its product exists, so an interrupted quickstart resumes.
"""

import importlib.util
import os
import shutil
import subprocess
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.core.arguments import CommandError, option, whole
from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.dataset.paths import check_root
from dynahoi_lerobot.doctor import cores
from dynahoi_lerobot.evaluate.checkpoint import WEIGHTS
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.evaluate.table import metrics_table
from dynahoi_lerobot.report.page import render_report
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.splits import SMALL_TEST

IMAGE_SIZE = 96
TRAINING = Path(__file__).with_suffix(".yaml")
"""LeRobot's training config: recipes/train/obact.yaml without evaluation; the command line sets
folders and steps."""
KINDS = BENCHMARK.splits[SMALL_TEST].motions
GIFS = 6
BASELINES = ("intercept", "constant_velocity", "hold")
NEEDS = ("torch", "lerobot", "lerobot_env_dynahoi", "lerobot_policy_obact")
"""Packages that the core does not install."""
SHOWN = ("S_loc", "S_joint", "E_loc", "R_time")
"""Metrics of the table in the terminal, which has 100 columns; the report shows all."""
TABLE = "table.txt"
"""Written last, so that its presence says that every baseline was evaluated."""
TASK_DONE = "metrics so far:"
"""What the environment prints after each kind of motion."""
STEPS_DONE, LOG_STEPS = " step:", 5
"""What `lerobot-train` prints, and every how many steps."""
THREADS = {"train": 2, "eval": 1}
"""Of torch: a training step takes 0.56 s on two cores instead of 0.79 s. Clips are recorded beside
the evaluation."""
POLICY = "obact"
"""Name of the trained policy's results."""


@dataclass(frozen=True)
class Size:
    """How much is done: dataset episodes, training steps, evaluation episodes per kind, and how
    many of ``KINDS``.
    """

    episodes: int = 800
    steps: int = 400
    per_kind: int = 2
    kinds: int = len(KINDS)


TINY = Size(episodes=2, steps=LOG_STEPS, per_kind=1, kinds=2)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi quickstart``."""

    out: Path = option(Path("outputs/quickstart"), "output folder")
    episodes: int = option(Size.episodes, "dataset episodes", whole(1, 10**6))
    steps: int = option(Size.steps, "training steps", whole(1, 10**6))
    evaluation_episodes: int = option(
        Size.per_kind, "evaluation episodes per kind of motion", whole(1, 1000)
    )
    tiny: bool = option(False, "smoke test with meaningless scores")
    open: bool = option(False, "open the report in the browser when done")


def run(options: Options) -> int:
    """Run the remaining stages; return the exit code."""
    if missing := [name for name in NEEDS if importlib.util.find_spec(name) is None]:
        raise ValueError(
            f"training needs {', '.join(missing)}: pip install '.[lerobot]' "
            f"./envs/lerobot_env_dynahoi "
            "./policies/lerobot_policy_obact, in a checkout"
        )
    check_root(out := options.out.resolve())
    size = (
        TINY if options.tiny else Size(options.episodes, options.steps, options.evaluation_episodes)
    )
    start = time.monotonic()
    with working_folder(out, {"quickstart": asdict(size)}):
        _run_stages(out, size)
    _conclude(out, start, show=options.open)
    return 0


def _run_stages(out: Path, size: Size) -> None:
    stages: list[tuple[str, Path, Callable[[Path, Size], None]]] = [
        ("generate a dataset", out / "dataset", _generate),
        ("encode its images", out / "encoded", _encode),
        ("train ObAct on it with lerobot-train", _checkpoint(out) / WEIGHTS, _train),
        ("evaluate it with lerobot-eval", out / "results" / POLICY, _evaluate),
    ]
    with ThreadPoolExecutor(1) as beside:
        baselines: Future[None] | None = None
        for number, (what, product, stage) in enumerate(stages, 1):
            begin, done = time.monotonic(), product.exists()
            if number > 1 and baselines is None and not (out / TABLE).exists():
                baselines = beside.submit(_baselines, out, size)
            if not done:
                stage(out, size)
            took = "already done" if done else f"{time.monotonic() - begin:.0f} s"
            print(f"[{number}/{len(stages)}] {what}: {took}", flush=True)
        if baselines is not None:
            baselines.result()


def _generate(out: Path, size: Size) -> None:
    words = ["--episodes", size.episodes, "--image-size", IMAGE_SIZE, "--workers", cores()]
    with (out / "generate.json").open("w", encoding="utf-8") as summary, redirect_stdout(summary):
        code = cli.main(["generate", "--root", str(out / "dataset"), *map(str, words)])
    if code:
        raise CommandError("dynahoi generate failed; see the message above")


def _encode(out: Path, size: Size) -> None:
    _dynahoi(out / "encode.log", "encode", out / "dataset", out / "encoded")


def _dynahoi(log: Path, *words: object) -> None:
    """Run a command in a process of its own, which prints into ``log``."""
    with log.open("w", encoding="utf-8") as file:
        command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", *map(str, words)]
        if code := subprocess.run(
            command, stdout=file, stderr=subprocess.STDOUT, env=_threads(1), check=False
        ).returncode:
            raise CommandError(f"dynahoi {words[0]} exited with code {code}; see {log}")


def _checkpoint(out: Path) -> Path:
    return out / "training" / "pretrained_model"


def _train(out: Path, size: Size) -> None:
    """Train; keep only the last checkpoint."""
    checkpoint, partial = _checkpoint(out), out / "training.partial"
    arguments = [
        f"--config_path={TRAINING}",
        f"--dataset.root={out / 'encoded'}",
        f"--output_dir={partial / 'run'}",
        f"--policy.device={_device()}",
        f"--steps={size.steps}",
        f"--save_freq={size.steps}",
        f"--log_freq={LOG_STEPS}",
    ]
    total, looks = (
        size.steps // LOG_STEPS,
        "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}",
    )
    bar: dict[str, Any] = {"total": total, "desc": "training", "bar_format": looks}
    with _run_into("train", arguments, out, partial, STEPS_DONE, **bar):
        checkpoint.parent.mkdir(exist_ok=True)
        (partial / "run" / "checkpoints" / "last" / checkpoint.name).rename(checkpoint)


def _evaluate(out: Path, size: Size) -> None:
    """Evaluate; keep the results only once every kind of motion has been played."""
    kinds, results, partial = (
        KINDS[: size.kinds],
        out / "results" / POLICY,
        out / "results" / f"{POLICY}.partial",
    )
    arguments = [
        f"--policy.path={_checkpoint(out)}",
        f"--policy.device={_device()}",
        "--env.type=dynahoi",
        f"--env.task={','.join(kinds)}",
        f"--env.split={SMALL_TEST}",
        f"--env.image_size={IMAGE_SIZE}",
        f"--env.results_dir={partial / results.name}",
        f"--eval.n_episodes={size.per_kind}",
        f"--eval.batch_size={size.per_kind}",
        "--seed=0",
        f"--output_dir={out / 'lerobot_eval'}",
    ]
    with ThreadPoolExecutor(1) as beside:
        filmed = beside.submit(_film, out, min(GIFS, len(kinds) * size.per_kind))
        with _run_into(
            "eval",
            arguments,
            out,
            partial,
            TASK_DONE,
            total=len(kinds),
            desc="evaluating",
            unit="kind",
        ):
            for clip in (film := filmed.result()).glob("*.gif"):
                clip.rename(partial / results.name / clip.name)
            shutil.rmtree(film, ignore_errors=True)
            (partial / results.name).rename(results)


@contextmanager
def _run_into(
    command: str, arguments: list[str], out: Path, partial: Path, step: str, **bar: Any
) -> Iterator[None]:
    """Run ``lerobot-train`` or ``lerobot-eval``; the body moves what is kept out of ``partial``."""
    log = out / f"lerobot_{command}.log"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    with tqdm(disable=None, leave=False, **bar) as progress:
        code = run_lerobot(command, arguments, log, step, progress)
    if code:
        raise CommandError(f"lerobot-{command} exited with code {code}; see {log}")
    yield
    shutil.rmtree(partial)


def run_lerobot(command: str, arguments: list[str], log: Path, step: str, bar: tqdm) -> int:
    """Return the exit code of ``lerobot-<command>``, which prints into ``log``; ``bar`` counts
    lines with ``step``.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", f"lerobot.scripts.lerobot_{command}", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=_threads(min(THREADS[command], cores())),
        encoding="utf-8",
        errors="replace",
    )
    assert process.stdout is not None
    with process, log.open("w", encoding="utf-8") as file:
        file.write(f"lerobot-{command} {' '.join(arguments)}\n")
        for line in process.stdout:
            file.write(line)
            bar.update(step in line)
        bar.refresh()  # the last lines come in a burst, of which tqdm shows the first alone
    return process.returncode


def _threads(count: int) -> dict[str, str]:
    """Return the environment of a process in which torch uses so many threads."""
    return os.environ | {"OMP_NUM_THREADS": str(count)}


def _film(out: Path, count: int) -> Path:
    """Record the trained policy's first ``count`` episodes as GIFs; return their folder."""
    shutil.rmtree(film := out / "film", ignore_errors=True)
    words = ["--policy", _checkpoint(out), "--out", film, "--episodes", count, "--gifs", count]
    _dynahoi(out / "film.log", "evaluate", *words)
    return film


def _device() -> str:
    """Return torch's name of the device: the GPU if there is one."""
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def _baselines(out: Path, size: Size) -> None:
    """Evaluate the privileged baselines on the same episodes."""
    count = size.kinds * size.per_kind
    for name in BASELINES:
        words = [
            "--policy",
            name,
            "--out",
            out / "results" / name,
            "--episodes",
            count,
            "--image-size",
            0,
        ]
        _dynahoi(out / f"{name}.log", "evaluate", *words)


def _conclude(out: Path, start: float, *, show: bool) -> None:
    """Write the report; print its table and the command that opens it."""
    folders = [out / "results" / name for name in (POLICY, *BASELINES)]
    page = render_report(folders, out / "report.html")
    results = [read_results(folder) for folder in folders]
    names = [result.marked(result.info.policy) for result in results]
    table = replace(metrics_table(names, results, SHOWN), caption="").as_text()
    (out / TABLE).write_text(table + "\n")
    print(
        f"\n{table}\n\nThese scores follow a short training; docs/results.md lists those of the "
        f"whole recipe."
    )
    print(
        f"done in {time.monotonic() - start:.0f} s; the report, with all metrics: "
        f"{page.resolve().as_uri()}"
    )
    if show:
        webbrowser.open(page.resolve().as_uri())
