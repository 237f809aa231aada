"""``dynahoi generate``: the command's arguments, progress and summary.

With ``--actor`` a policy moves the hand, and the expert labels its states.
"""

import json
import shlex
import sys
from dataclasses import MISSING, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import given_of, number, option, refuse_given, whole
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.progress import progress_bar
from dynahoi_lerobot.core.reading import reading
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH, FileLimits, check_root
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.evaluate.actors import TRUST, playing_rules
from dynahoi_lerobot.generate.actor import actor_name, make_actor, open_policy, runtime
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan, Record, shard_size
from dynahoi_lerobot.rollout import loop
from dynahoi_lerobot.rollout.recording import Recording, read_recording

EXECUTORS = ("local", "slurm", "ray")
FOR_EXECUTORS = ("tasks", "dry_run", "partition", "time", "cpus_per_task", "gpus_per_task")
"""Options without effect unless an executor is named."""
LONGEST_VIDEO_S = 1e9
"""No dataset is longer."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi generate``."""

    root: Path = option(MISSING, "dataset folder; an incomplete one is resumed")
    recipe: Path | None = option(None, "YAML file; the options below override it")
    episodes: int = option(MISSING, "number of episodes")
    seed: int = option(0, "seed of the first episode; episode i has seed + i")
    given: dict[str, Any] = given_of(Recording)
    subtasks: bool = option(False, "store the current subtask in LeRobot's language column")
    workers: int = option(1, "number of processes", whole(1, 4096))
    shard_episodes: int | None = option(
        None, "episodes per shard; by default an eighth of all, at most 256"
    )
    encoding: dict[str, Any] = given_of(Encoding)
    video_seconds: float = option(
        FileLimits.video_s,
        "maximum length of a video file [s], and at most 200 MB; LeRobot can only stream one "
        "file per view",
        number(1.0, LONGEST_VIDEO_S),
    )
    executor: str | None = option(None, "run the shards as datatrove tasks", choices=EXECUTORS)
    tasks: int | None = option(None, "number of tasks; one per shard by default", whole(1, 100_000))
    dry_run: bool = option(False, "print what --executor would do")
    partition: str = option("cpu", "Slurm partition")
    time: str = option("24:00:00", "Slurm time limit per task")
    cpus_per_task: int = option(1, "Slurm CPUs per task", whole(1, 4096))
    gpus_per_task: int = option(0, "Slurm GPUs per task", whole(0, 64))
    json: Path | None = option(None, "also write the summary to this file")
    actor: str | None = option(
        None, "policy that moves the hand while the expert labels its states", metavar="CHECKPOINT"
    )
    trust: bool = option(False, TRUST)


def run(
    options: Options, *, record: Record | None = None, recording: Recording | None = None
) -> int:
    """Generate a dataset and print a JSON summary.

    Args:
        options: of the command line.
        record: plays the expert without ``--actor``; ``dynahoi_lerobot.rollout.loop.record`` by
            default.
        recording: the options override its values; the default recording by default.

    Returns:
        The exit code, 0.
    """
    check_output(options.root)
    check_root(options.root)
    complete = options.root.exists()
    if options.executor is None:
        refuse_given(
            options,
            FOR_EXECUTORS,
            f"needs --executor {', '.join(EXECUTORS[:-1])} or {EXECUTORS[-1]}",
        )
    told = (read_recording(options.recipe) if options.recipe else {}) | options.given
    runs_on = ""
    if options.actor is not None:
        told, runs_on, record = _on_policy(options.actor, options, told)
    recording = changed(recording or Recording(), told)
    if options.given.get("views") and not recording.recipe.rules.image_size:
        raise ValueError("--views needs images: image_size is 0, no camera")
    plan = _plan(options, recording, runs_on)
    if options.executor is not None:
        from dynahoi_lerobot.generate import executors

        resources = executors.ClusterResources(
            options.tasks, -1 if options.workers == 1 else options.workers, options.cpus_per_task,
            gpus_per_task=options.gpus_per_task, partition=options.partition, time=options.time,
        )  # fmt: skip
        recorder = record or partial(loop.record, threads=options.cpus_per_task)
        work = (options.executor, plan, options.root, recorder, resources)
        if options.dry_run or not executors.run(*work):
            print(executors.describe(*work))
            return 0
    record = record or partial(loop.record, threads=_threads(options))
    with progress_bar(
        total=plan.episodes, desc="generating", unit="episode", smoothing=0.05
    ) as bar:
        manifest = generate(
            plan,
            options.root,
            record=record,
            workers=options.workers,
            progress=lambda done: bar.update(done - bar.n),
        )
    if complete:
        print(f"{options.root} was already complete and agrees with its manifest", file=sys.stderr)
    summary = _summary(options.root, manifest)
    print(json.dumps(summary, indent=2))
    if options.json:
        options.json.write_text(json.dumps(summary, indent=2))
    root = shlex.quote(str(options.root))
    look = f"dynahoi view --dataset {root} --episode 0 --out episode.html"
    print(f"next: {look}\n      dynahoi verify {root}", file=sys.stderr)
    return 0


def _on_policy(
    actor: str, options: Options, told: dict[str, Any]
) -> tuple[dict[str, Any], str, Record]:
    """Return the values of the recording, those ``told`` and those of the policy of ``--actor``;
    its ``runtime``; and its recorder.
    """
    policy = open_policy(actor, trust=options.trust)
    name = actor_name(actor)
    if told.get("actor", name) != name:
        raise ValueError(f"the recipe names the actor {told['actor']}; --actor {actor} is {name}")
    runs_on = runtime(policy)
    make = partial(make_actor, path=actor, name=name, on=runs_on, trust=options.trust)
    record = partial(loop.record_on_policy, make_agent=make, threads=_threads(options))
    return playing_rules(told, policy) | {"actor": name}, runs_on, record


def _threads(options: Options) -> int:
    """Return how many threads share the worlds of one process: all cores (0) if it is the only
    one.
    """
    return 0 if options.workers == 1 else 1


def _plan(options: Options, recording: Recording, runs_on: str) -> GenerationPlan:
    if recording.actor and options.actor is None:
        raise ValueError(
            f"the recipe names the actor {recording.actor}; give its checkpoint with --actor"
        )
    return GenerationPlan(
        recording,
        options.episodes,
        options.seed,
        _encoding(options),
        FileLimits(video_s=options.video_seconds),
        shard_size(options.episodes) if options.shard_episodes is None else options.shard_episodes,
        runtime=runs_on,
        subtasks=options.subtasks,
    )


def _encoding(options: Options) -> Encoding:
    given = options.encoding
    encoding = Encoding(**given)
    settings = [name for name in given if name != "codec"]
    if settings and not encoding.is_video:
        raise ValueError(
            f"{settings[0]} is {given[settings[0]]!r}; images has none, only a video has"
        )
    return encoding


def _summary(root: Path, manifest: Manifest) -> dict[str, Any]:
    size = sum((root / name).stat().st_size for name in manifest.files)
    yields = manifest.yields
    with reading(root / MANIFEST_PATH):
        return {
            "root": str(root),
            "episodes": manifest.episodes,
            "frames": manifest.frames,
            "megabytes": round(size / 1e6, 1),
            "yield": round((yields["kept"] - yields["failed"]) / yields["tried"], 4),
            "failed": yields["failed"],
            "rejected": yields["rejected"],
            "sha256": manifest.digest,
        }
