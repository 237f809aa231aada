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
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from tqdm import tqdm

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.core.arguments import CommandError, option, whole
from dynahoi_lerobot.core.machine import cores
from dynahoi_lerobot.core.progress import progress_bar
from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.dataset.paths import check_root
from dynahoi_lerobot.evaluate.checkpoint_files import WEIGHTS
from dynahoi_lerobot.evaluate.results import METRICS_FILE, read_results
from dynahoi_lerobot.evaluate.table import metrics_table
from dynahoi_lerobot.report.page import render_report
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.splits import SMALL_TEST, split_seeds

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


TINY = {"episodes": 2, "steps": 5, "evaluation_episodes": 1}
TINY_KINDS = 2
"""What ``--tiny`` does: values of the options, and how many of ``KINDS``."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi quickstart``."""

    out: Path = option(Path("outputs/quickstart"), "output folder")
    episodes: int = option(800, "dataset episodes", whole(1, 10**6))
    steps: int = option(400, "training steps", whole(1, 10**6))
    evaluation_episodes: int = option(
        2,
        "evaluation episodes per kind of motion",
        whole(1, len(split_seeds(SMALL_TEST)) // len(KINDS)),
    )
    tiny: bool = option(False, "smoke test with meaningless scores")
    open: bool = option(False, "open the report in the browser when done")

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of motion that are evaluated."""
        return KINDS[:TINY_KINDS] if self.tiny else KINDS


def run(options: Options) -> int:
    """Run the remaining stages; return the exit code."""
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ValueError(
            f"training needs {', '.join(missing)}: pip install '.[lerobot]' "
            f"./envs/lerobot_env_dynahoi "
            "./policies/lerobot_policy_obact, in a checkout"
        )
    options = replace(options, out=options.out.resolve(), **TINY if options.tiny else {})
    check_root(options.out)
    task = {
        "episodes": options.episodes,
        "steps": options.steps,
        "per_kind": options.evaluation_episodes,
        "kinds": len(options.kinds),
    }
    start = time.monotonic()
    with working_folder(options.out, {"quickstart": task}):
        _run_stages(options)
    _conclude(options.out, start, show=options.open)
    return 0


def _run_stages(options: Options) -> None:
    """Run the stages whose products do not exist, with the baselines beside the later ones."""
    out = options.out
    stages: list[tuple[str, Path, Callable[[Options], None]]] = [
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
                baselines = beside.submit(_baselines, options)
            if product.exists():
                took = "already done"
            else:
                stage(options)
                took = f"{time.monotonic() - begin:.0f} s"
            print(f"[{number}/{len(stages)}] {title}: {took}", flush=True)
        if baselines is not None:
            baselines.result()


def _generate(options: Options) -> None:
    out = options.out
    words = ["--episodes", options.episodes, "--image-size", IMAGE_SIZE, "--workers", cores()]
    with (out / "generate.json").open("w", encoding="utf-8") as summary, redirect_stdout(summary):
        code = cli.main(["generate", "--root", str(out / "dataset"), *map(str, words)])
    if code:
        raise CommandError("dynahoi generate failed; see the message above")


def _encode(options: Options) -> None:
    out = options.out
    _dynahoi(out / "encode.log", "encode", out / "dataset", out / "encoded")


def _checkpoint(out: Path) -> Path:
    return out / "training" / "pretrained_model"


def _train(options: Options) -> None:
    """Train; keep only the last checkpoint."""
    out = options.out
    partial = _emptied(out / "training.partial")
    checkpoints = partial / "run" / "checkpoints"
    every = max(1, options.steps // SAVES)
    arguments = [
        f"--config_path={TRAINING}",
        f"--dataset.root={out / 'encoded'}",
        f"--output_dir={checkpoints.parent}",
        f"--policy.device={_device()}",
        f"--steps={options.steps}",
        f"--save_freq={every}",
        f"--log_freq={every}",
    ]
    looks = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    with progress_bar(total=options.steps, desc="training", bar_format=looks) as bar:
        run_lerobot("train", arguments, out, lambda: _steps(checkpoints), bar)
    checkpoint = _checkpoint(out)
    checkpoint.parent.mkdir(exist_ok=True)
    (checkpoints / "last" / checkpoint.name).rename(checkpoint)
    shutil.rmtree(partial)


def _steps(checkpoints: Path) -> int:
    """Return how many steps have been trained when the last checkpoint was saved."""
    return max((int(folder.name) for folder in checkpoints.glob("[0-9]*")), default=0)


def _evaluate(options: Options) -> None:
    """Evaluate; keep the results only once every kind of motion has been played."""
    out = options.out
    per_kind = options.evaluation_episodes
    episodes = len(options.kinds) * per_kind
    results = out / "results" / POLICY
    partial = _emptied(out / "results" / f"{POLICY}.partial")
    made = partial / POLICY
    arguments = [
        f"--policy.path={_checkpoint(out)}",
        f"--policy.device={_device()}",
        "--env.type=dynahoi",
        f"--env.task={','.join(options.kinds)}",
        f"--env.split={SMALL_TEST}",
        f"--env.image_size={IMAGE_SIZE}",
        f"--env.results_dir={made}",
        f"--eval.n_episodes={per_kind}",
        f"--eval.batch_size={per_kind}",
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
    words = ["dynahoi_lerobot.cli.lerobot_command", command, *arguments]
    log = out / f"lerobot_{command}.log"
    _run(f"lerobot-{command}", words, log, lambda: bar.update(done() - bar.n))
    bar.refresh()


def _dynahoi(log: Path, command: str, *words: object) -> None:
    """Run a command in a process of its own, which prints into ``log``."""
    _run(f"dynahoi {command}", ["dynahoi_lerobot.cli.main", command, *words], log)


def _run(
    name: str, words: Sequence[object], log: Path, look: Callable[[], object] = lambda: None
) -> None:
    """Run ``python -m`` with ``words``; ``look`` is called every second and at the end."""
    command = [sys.executable, "-m", *map(str, words)]
    with log.open("w", encoding="utf-8") as file:
        print(*command, file=file, flush=True)
        process = subprocess.Popen(command, stdout=file, stderr=file, env=_one_thread())
        try:
            while process.returncode is None:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(POLL_S)
                look()
        finally:
            process.terminate()
            process.wait()
    if process.returncode:
        raise CommandError(f"{name} exited with code {process.returncode}; see {log}")


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


def _baselines(options: Options) -> None:
    """Evaluate the privileged baselines on the same episodes."""
    episodes = len(options.kinds) * options.evaluation_episodes
    words = ["--episodes", episodes, "--image-size", 0]
    for name in BASELINES:
        log = options.out / f"{name}.log"
        folder = options.out / "results" / name
        _dynahoi(log, "evaluate", "--policy", name, "--out", folder, *words)


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
