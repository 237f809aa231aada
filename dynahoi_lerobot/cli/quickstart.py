"""``dynahoi quickstart``: dataset, training, evaluation and report, in minutes on two CPU cores.

generate -> encode -> lerobot-train (ObAct) -> lerobot-eval -> report. The privileged baselines,
which need no checkpoint, are evaluated beside the training, which leaves a core idle. A stage is
skipped if its product exists, so an interrupted quickstart resumes.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
import webbrowser
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from tqdm import tqdm

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.core.arguments import CommandError, option, whole
from dynahoi_lerobot.core.progress import progress_bar
from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.dataset.paths import check_root
from dynahoi_lerobot.doctor import cores
from dynahoi_lerobot.evaluate.checkpoint import WEIGHTS
from dynahoi_lerobot.evaluate.results import METRICS_FILE, read_results
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
SAVES = 10
"""Checkpoints of a training, whose steps the progress bar shows; the last is kept."""
POLL_S = 1.0
"""Time between two looks at the files that LeRobot writes."""
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


TINY = Size(episodes=2, steps=5, per_kind=1, kinds=2)


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
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ValueError(
            f"training needs {', '.join(missing)}: pip install '.[lerobot]' "
            f"./envs/lerobot_env_dynahoi "
            "./policies/lerobot_policy_obact, in a checkout"
        )
    out = options.out.resolve()
    check_root(out)
    size = Size(options.episodes, options.steps, options.evaluation_episodes)
    if options.tiny:
        size = TINY
    start = time.monotonic()
    with working_folder(out, {"quickstart": asdict(size)}):
        _run_stages(out, size)
    _conclude(out, start, show=options.open)
    return 0


def _run_stages(out: Path, size: Size) -> None:
    """Run the stages whose products do not exist, with the baselines beside the later ones."""
    stages: list[tuple[str, Path, Callable[[Path, Size], None]]] = [
        ("generate a dataset", out / "dataset", _generate),
        ("encode its images", out / "encoded", _encode),
        ("train ObAct on it with lerobot-train", _checkpoint(out) / WEIGHTS, _train),
        ("evaluate it with lerobot-eval", out / "results" / POLICY, _evaluate),
    ]
    with ThreadPoolExecutor(1) as beside:
        baselines: Future[None] | None = None
        for number, (title, product, stage) in enumerate(stages, 1):
            begin = time.monotonic()
            if number > 1 and baselines is None and not (out / TABLE).exists():
                baselines = beside.submit(_baselines, out, size)
            if product.exists():
                took = "already done"
            else:
                stage(out, size)
                took = f"{time.monotonic() - begin:.0f} s"
            print(f"[{number}/{len(stages)}] {title}: {took}", flush=True)
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


def _checkpoint(out: Path) -> Path:
    return out / "training" / "pretrained_model"


def _train(out: Path, size: Size) -> None:
    """Train; keep only the last checkpoint."""
    partial = _emptied(out / "training.partial")
    checkpoints = partial / "run" / "checkpoints"
    every = max(1, size.steps // SAVES)
    arguments = [
        f"--config_path={TRAINING}",
        f"--dataset.root={out / 'encoded'}",
        f"--output_dir={checkpoints.parent}",
        f"--policy.device={_device()}",
        f"--steps={size.steps}",
        f"--save_freq={every}",
        f"--log_freq={every}",
    ]
    looks = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    with progress_bar(total=size.steps, desc="training", bar_format=looks) as bar:
        run_lerobot("train", arguments, out, lambda: _steps(checkpoints), bar)
    checkpoint = _checkpoint(out)
    checkpoint.parent.mkdir(exist_ok=True)
    (checkpoints / "last" / checkpoint.name).rename(checkpoint)
    shutil.rmtree(partial)


def _steps(checkpoints: Path) -> int:
    """Return how many steps have been trained when the last checkpoint was saved."""
    return max((int(folder.name) for folder in checkpoints.glob("[0-9]*")), default=0)


def _evaluate(out: Path, size: Size) -> None:
    """Evaluate; keep the results only once every kind of motion has been played."""
    kinds = KINDS[: size.kinds]
    episodes = len(kinds) * size.per_kind
    results = out / "results" / POLICY
    partial = _emptied(out / "results" / f"{POLICY}.partial")
    made = partial / POLICY
    arguments = [
        f"--policy.path={_checkpoint(out)}",
        f"--policy.device={_device()}",
        "--env.type=dynahoi",
        f"--env.task={','.join(kinds)}",
        f"--env.split={SMALL_TEST}",
        f"--env.image_size={IMAGE_SIZE}",
        f"--env.results_dir={made}",
        f"--eval.n_episodes={size.per_kind}",
        f"--eval.batch_size={size.per_kind}",
        "--seed=0",
        f"--output_dir={out / 'lerobot_eval'}",
    ]
    with ThreadPoolExecutor(1) as beside:
        filmed = beside.submit(_film, out, min(GIFS, episodes))
        with progress_bar(total=episodes, desc="evaluating", unit="episode") as bar:
            run_lerobot("eval", arguments, out, lambda: _played(made), bar)
        film = filmed.result()
    for clip in film.glob("*.gif"):
        clip.rename(made / clip.name)
    shutil.rmtree(film, ignore_errors=True)
    made.rename(results)
    shutil.rmtree(partial)


def _played(results: Path) -> int:
    """Return how many episodes the environment has written; it does after every kind of motion."""
    head = results / METRICS_FILE
    return json.loads(head.read_text())["n"] if head.exists() else 0


def _emptied(folder: Path) -> Path:
    """Make a folder anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def run_lerobot(
    command: str, arguments: list[str], out: Path, done: Callable[[], int], bar: tqdm
) -> None:
    """Run ``lerobot-<command>``, which prints into a log below ``out``; ``bar`` shows what is
    ``done``.

    Raises:
        CommandError: if it fails.
    """
    log = out / f"lerobot_{command}.log"
    words = [sys.executable, "-m", "dynahoi_lerobot.cli.lerobot_command", command, *arguments]
    with log.open("w", encoding="utf-8") as file:
        print(f"lerobot-{command}", *arguments, file=file, flush=True)
        process = subprocess.Popen(words, stdout=file, stderr=subprocess.STDOUT, env=_one_thread())
        try:
            while process.poll() is None:
                time.sleep(POLL_S)
                bar.update(done() - bar.n)
        finally:
            process.terminate()
            process.wait()
    bar.update(done() - bar.n)
    bar.refresh()
    if process.returncode:
        raise CommandError(f"lerobot-{command} exited with code {process.returncode}; see {log}")


def _dynahoi(log: Path, *words: object) -> None:
    """Run a command in a process of its own, which prints into ``log``."""
    command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", *map(str, words)]
    with log.open("w", encoding="utf-8") as file:
        code = subprocess.call(command, stdout=file, stderr=subprocess.STDOUT, env=_one_thread())
    if code:
        raise CommandError(f"dynahoi {words[0]} exited with code {code}; see {log}")


def _one_thread() -> dict[str, str]:
    """Return the environment of a process in which torch computes on one thread.

    LeRobot's loader and the baselines need another core: on two, a training step takes 0.53 s with
    one thread, and 0.72 s with two.
    """
    return os.environ | {"OMP_NUM_THREADS": "1"}


def _film(out: Path, count: int) -> Path:
    """Record the trained policy's first ``count`` episodes as GIFs; return their folder."""
    film = out / "film"
    shutil.rmtree(film, ignore_errors=True)
    words = ["--policy", _checkpoint(out), "--out", film, "--episodes", count, "--gifs", count]
    _dynahoi(out / "film.log", "evaluate", *words)
    return film


def _device() -> str:
    """Return torch's name of the device: the GPU if there is one."""
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def _baselines(out: Path, size: Size) -> None:
    """Evaluate the privileged baselines on the same episodes."""
    options = ["--episodes", size.kinds * size.per_kind, "--image-size", 0]
    for name in BASELINES:
        folder = out / "results" / name
        _dynahoi(out / f"{name}.log", "evaluate", "--policy", name, "--out", folder, *options)


def _conclude(out: Path, start: float, *, show: bool) -> None:
    """Write the report; print its table and the command that opens it."""
    folders = [out / "results" / name for name in (POLICY, *BASELINES)]
    page = render_report(folders, out / "report.html")
    results = [read_results(folder) for folder in folders]
    names = [result.marked(result.info.policy) for result in results]
    table = replace(metrics_table(names, results, SHOWN), caption="").as_text()
    (out / TABLE).write_text(table + "\n")
    address = page.resolve().as_uri()
    print(f"\n{table}\n")
    print("These scores follow a short training; docs/results.md lists those of the whole recipe.")
    print(f"done in {time.monotonic() - start:.0f} s; the report, with all metrics: {address}")
    if show:
        webbrowser.open(address)
