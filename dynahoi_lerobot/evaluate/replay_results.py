"""``dynahoi evaluate --replay RESULTS``: the logged commands are played again and every number is
recomputed.

A replay shows that the commands in a folder, given in the episodes of its split, lead to the
results in it. It does not show who or what gave the commands, from which observations, or how long
that took: a log of the expert's commands under another name replays, too.
"""

import math
import reprlib
import secrets
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.core.nested import flat
from dynahoi_lerobot.core.numerics import TOLERANCE
from dynahoi_lerobot.core.progress import progress_bar
from dynahoi_lerobot.core.reading import sha256
from dynahoi_lerobot.evaluate.results import (
    ACTIONS_FILE,
    EPISODES_FILE,
    METRICS_FILE,
    Results,
    read_results,
)
from dynahoi_lerobot.evaluate.rows import Row, episode_row
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.rollout.inference import SYNC
from dynahoi_lerobot.rollout.loop import replay
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from dynahoi_lerobot.sampling.fingerprint import recipe_code, surroundings
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.salt import seal, split_of
from dynahoi_lerobot.sampling.splits import split_seeds

PLAYED_TOGETHER = 32
SHOWN = 10
"""Findings that are printed."""
NOT_REPLAYED = {"agent", "code"}
"""Columns that do not follow from the commands."""
COMPUTED = ("n", "n_success", "pc_success_ci95", "metrics", "per_kind")
"""Entries of ``metrics.json`` that follow from the rows."""


def run(folder: Path, salt: str, count: int | None, seed: int | None) -> int:
    """Replay ``count`` episodes (all for None), drawn with ``seed`` (random for None), and print
    what differs.

    Returns:
        The exit code: 0 if every number is the same, else 1.
    """
    results = read_results(folder)
    recipe = open_recipe(results, salt)
    if recipe_code(recipe) != results.info.code:
        made_by = printable(_otherwise(results))
        print(f"made by {made_by}, so that numbers may differ by more than rounding")
    for name in (METRICS_FILE, EPISODES_FILE, ACTIONS_FILE):
        print(f"sha256 {sha256(results.folder / name)}  {results.folder / name}")
    for name, (value, rule) in (changed_rules(results) | _unseen_rules(results)).items():
        print(f"not the benchmark's {name}: {reprlib.repr(value)} instead of {reprlib.repr(rule)}")
    seed = secrets.randbits(32) if seed is None else seed
    chosen = drawn(len(results.rows), count, seed)
    findings = replay_problems(results, recipe, chosen)
    for finding in findings[:SHOWN]:
        print(printable(finding))
    of = (
        f"{len(results.rows)} episodes in the folder, "
        f"{len(split_seeds(split_of(results.info.split)))} in the split"
    )
    print(f"{len(chosen)} episodes drawn with --replay-seed {seed}, of {of}")
    if findings:
        print(f"not the same: {len(findings)} found")
        return 1
    print(
        "every number is the same; no command tells the policy, its settings, its observations "
        "and its inference time"
    )
    return 0


def drawn(n_rows: int, count: int | None, seed: int) -> list[int]:
    """Return ``count`` of ``n_rows`` rows drawn at random; all of them for None."""
    if count is None or count >= n_rows:
        return list(range(n_rows))
    return sorted(np.random.default_rng(seed).choice(n_rows, count, replace=False).tolist())


def open_recipe(results: Results, salt: str = "") -> Recipe:
    """Return the recipe that was played, with its salt in place of the salt's hash.

    Raises:
        ReadError: if the folder does not name its recipe.
        ValueError: if the results are of another salt.
    """
    recipe = results.recipe()
    if seal(recipe.salt) != seal(salt):
        found, said = (
            f"salt {seal(one)}" if one else "the public stream" for one in (recipe.salt, salt)
        )
        raise ValueError(f"the results are of {found}, not of {said}, as --salt says")
    return replace(recipe, salt=salt)


def changed_rules(results: Results) -> dict[str, tuple[Any, Any]]:
    """Return the fields of a result's recipe that are not the benchmark's, with their values and
    the benchmark's.

    Raises:
        ReadError: if something that it names does not exist here.
    """
    recipe = results.recipe()
    usual = Rules(capture=recipe.rules.capture, control_class=recipe.rules.control_class)
    benchmark = flat(Recipe(rules=usual, split=recipe.split).stored())
    played = flat(recipe.stored())
    return {
        name: (played[name], value) for name, value in benchmark.items() if played[name] != value
    }


def _unseen_rules(results: Results) -> dict[str, tuple[Any, Any]]:
    """Return the settings of a result's policy that differ from the benchmark's, and that no replay
    can tell.
    """
    said = {
        "inference": results.conditions["inference"],
        "privileged": results.privileged,
        "settings": results.info.extra.get("settings") or [],
    }
    usual = {"inference": SYNC, "privileged": False, "settings": []}
    return {name: (value, usual[name]) for name, value in said.items() if value != usual[name]}


def replay_problems(results: Results, recipe: Recipe, chosen: Sequence[int]) -> list[str]:
    """Return what is wrong in results by themselves, or, if nothing is, in the rows ``chosen`` when
    they are played again.
    """
    problems = list(_problems_of_files(results))
    if problems:
        return problems
    with progress_bar(total=len(chosen), desc="replaying", unit="episode") as progress:
        for group in batched(chosen, PLAYED_TOGETHER):
            logs = [results.log(i) for i in group]
            episodes = replay(recipe, logs, images=False, as_evaluated=True)
            for i, episode in zip(group, episodes, strict=True):
                problems += _wrong_values(episode, results.rows[i])
                problems += _wrong_actions(episode, results.actions[i])
                progress.update()
    return problems


def _problems_of_files(results: Results) -> Iterator[str]:
    """Yield what in results and their folder is wrong before anything is played."""
    info = results.info
    split = split_of(results.info.split)
    if info.benchmark != BENCHMARK_ID:
        yield f"the results are of benchmark {info.benchmark}, here is {BENCHMARK_ID}"
    for name, played in (("split", info.split), ("capture", info.capture)):
        if results.head[name] != played:
            yield f"metrics.json names {name} {results.head[name]}, but its recipe plays {played}"
    order = [row["seed"] for row in results.rows]
    if order != sorted(order):
        yield "the episodes are not in the order of their split"
    seeds = Counter(order)
    repeated = sorted(seed for seed, count in seeds.items() if count > 1)
    if repeated:
        yield f"seed {repeated[0]} is there {seeds[repeated[0]]} times"
    foreign = sorted(set(seeds) - set(split_seeds(split)))
    if foreign:
        yield f"seed {foreign[0]} is not in split {info.split}"
    for row in results.rows:
        if row["code"] != info.code:
            yield (
                f"seed {row['seed']} was played by code {row['code']}, metrics.json names "
                f"{info.code}"
            )
    again = [row for row in results.rows if row["attempts"] != 1]
    if again and not results.privileged:
        yield f"seed {again[0]['seed']} took {again[0]['attempts']} attempts; a policy has one"
    stored = dict(_computed(results.head))
    recomputed = dict(_computed(results.as_json()))
    unknown = results.head["metrics"].keys() - set(METRICS.names())
    for name in recomputed | stored:
        said = stored.get(name)
        found = recomputed.get(name)
        if unknown.isdisjoint(name.split("/")) and not _equal(said, found):
            yield f"{name} is {said} in metrics.json and {found} over the episodes"


def _otherwise(results: Results) -> str:
    """Return what has changed since the results were made, as far as they tell."""
    stored = results.info.extra.get("surroundings")
    if stored is None:
        return "other code, library versions or kind of processor"
    differs = [
        f"{name} {stored.get(name)}, not {here}"
        for name, here in surroundings().items()
        if stored.get(name) != here
    ]
    return f"other surroundings: {'; '.join(differs)}" if differs else "other code"


def _computed(head: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield what in ``metrics.json`` follows from the rows, by names such as
    ``metrics/S_loc/value``.
    """
    pending = [(name, head[name]) for name in COMPUTED]
    while pending:
        name, value = pending.pop(0)
        if isinstance(value, dict):
            pending += [(f"{name}/{key}", inner) for key, inner in value.items()]
        else:
            yield name, value


def _wrong_values(episode: Episode, row: Row) -> Iterator[str]:
    """Yield columns of a row that the replayed episode does not confirm; a metric that was not
    measured says nothing.
    """
    for name, value in episode_row(episode).items():
        if name in row and name not in NOT_REPLAYED and not _equal(row[name], value):
            yield f"seed {row['seed']}: {name} is {row[name]!r}, replayed it is {value!r}"


def _wrong_actions(episode: Episode, actions: np.ndarray) -> Iterator[str]:
    """Yield that a log is not as long as its episode, or its first command that the world did not
    take as it is.
    """
    seed = episode.meta.seed
    if len(episode) != len(actions):
        yield (
            f"seed {seed}: the log has {len(actions)} commands, an evaluation with them "
            f"{len(episode)} frames"
        )
        return
    differs = np.abs(episode.action - actions).max(axis=1) > TOLERANCE
    if differs.any():
        yield f"seed {seed}: the command of frame {differs.argmax()} is beyond what the hand can do"


def _equal(one: object, other: object) -> bool:
    """Tell whether two values of a row agree, numbers within ``TOLERANCE``."""
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=0.0, abs_tol=TOLERANCE)
    return one == other
