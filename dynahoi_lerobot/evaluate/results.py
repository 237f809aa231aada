"""The result folder of one evaluation: ``metrics.json``, ``episodes.parquet`` and
``actions.npz``, with the episodes in the order of their split.
"""

import io
import json
import shlex
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self, get_type_hints

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_DOF, SEED_LIMIT
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.nested import flat
from dynahoi_lerobot.core.reading import (
    LeftOut,
    ReadError,
    open_table,
    read_arrays,
    read_object,
    read_rows,
    reading,
    require,
    require_schema,
    validated,
)  # fmt: skip
from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.evaluate.rows import METRIC_TYPE, Row, episode_row, measured
from dynahoi_lerobot.evaluate.summary import Estimate, Summary, summarize_by, summarize_rows, wilson
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.metrics.columns import COLUMNS
from dynahoi_lerobot.rollout.inference import SYNC
from dynahoi_lerobot.rollout.loop import ActionLog
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from dynahoi_lerobot.sampling.fingerprint import recipe_code, surroundings
from dynahoi_lerobot.sampling.recipe import COMPARED, Recipe
from dynahoi_lerobot.sampling.salt import stream_label, without_salt

METRICS_FILE = "metrics.json"
EPISODES_FILE = "episodes.parquet"
ACTIONS_FILE = "actions.npz"

SCHEMA = 1
"""What the three files hold. A reader refuses another number. A key or column that may be missing
is added without changing it, and is ignored by readers that do not know it."""
OTHER_SCHEMA = "evaluate again with this version, or read it with the version that wrote it"
"""What to do about results of another schema."""

HEAD_TYPES: dict[str, Any] = {
    "n": int,
    "n_success": int,
    "pc_success_ci95": list[float],
    "metrics": dict[str, Estimate],
    "per_kind": dict[str, dict[str, Estimate]],
    "recipe": dict[str, Any],
    "extra": dict[str, Any],
} | dict.fromkeys(("split", "policy", "capture", "code", "benchmark", "command"), str)
EXTRA_TYPES = {
    "inference": str | None,
    "settings": list[str] | None,
    "privileged": bool | None,
    "weights": dict[str, str] | None,
    "episodes_asked": int,
    "surroundings": dict[str, Any],
    "vlm": dict[str, Any],
}
"""Keys of ``metrics.json`` with the types of their values; values below ``extra`` may be
missing."""

CONDITIONS = (*COMPARED, "inference")
"""What must be equal for two evaluations to be compared."""

LARGEST = SEED_LIMIT
"""No number in a row or a command is larger."""

REMEDY = "run `dynahoi evaluate` with this folder as --out"
WEIGHTS = "weights"
"""Key of the sha256 of a policy's files of weights, by name."""


def command_line() -> str:
    """Return the command line as results keep it: printable, quoted for a shell, its program
    without the folder, a salt hidden.
    """
    return printable(shlex.join([Path(sys.argv[0]).name, *without_salt(sys.argv[1:])]))


@dataclass(frozen=True)
class RunInfo:
    """What was evaluated and how.

    Attributes:
        policy: the policy's name or path.
        recipe: the episodes' recipe, as ``Recipe.stored`` returns it.
        command: the exact command line.
        code: fingerprint of the code that played it.
        extra: further JSON values: ``privileged`` if who moved the hand saw the simulator's state,
            ``episodes_asked``, how many are to be played, ``inference`` and ``settings`` where
            inference took time or the policy's config was changed, ``weights``, sha256 by the name
            of the file, those of an adapter's base model under ``base/NAME``, and whatever a figure
            needs, such as ``n_obs_steps`` or ``data_fraction``.
        benchmark: identifies the benchmark; scores of another one do not compare.
    """

    policy: str
    recipe: dict[str, Any]
    command: str
    code: str
    extra: dict[str, Any] = field(default_factory=dict)
    benchmark: str = BENCHMARK_ID

    @classmethod
    def begun(
        cls, policy: str, recipe: Recipe, weights: Mapping[str, str] | None = None, **facts: Any
    ) -> Self:
        """Return what this command line begins to play, of a recipe; ``facts`` and ``weights`` are
        in ``extra``.
        """
        extra = {**facts, "surroundings": surroundings()}
        extra |= {} if weights is None else {WEIGHTS: dict(weights)}
        return cls(policy, recipe.stored(), command_line(), recipe_code(recipe), extra)

    @property
    def split(self) -> str:
        """The split that was played, with digits of the salt's hash."""
        return stream_label(self.recipe["split"], self.recipe["salt"])

    @property
    def capture(self) -> str:
        """The capture rule."""
        return self.recipe["rules"]["capture"]

    def task(self) -> dict[str, Any]:
        """Return what must be equal for an evaluation to be resumed."""
        facts: dict[str, Any] = {"schema": SCHEMA}
        facts |= {name: self.extra.get(name) or "" for name in ("inference", "settings", WEIGHTS)}
        return {
            name: getattr(self, name) for name in ("policy", "recipe", "code", "benchmark")
        } | facts


@dataclass(frozen=True, eq=False)
class Results:
    """One evaluation: its conditions, and a row and the actions of every episode, no images.

    Attributes:
        folder: where it was read from or written to.
        info: the policy and the conditions.
        rows: one row an episode, as ``episode_row`` makes them, by ascending seed, which is the
            order of the split. A metric that was not measured is missing in them.
        actions: one (T, 18) float32 array an episode, palm position [m], home frame, and joint
            angles [rad].
        head: what ``metrics.json`` held; empty for results that were not read.
    """

    folder: Path
    info: RunInfo
    rows: tuple[Row, ...] = ()
    actions: tuple[np.ndarray, ...] = field(default=(), repr=False)
    head: dict[str, Any] = field(default_factory=dict, repr=False)
    _by: dict[str, dict[str, Summary]] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def resumed(cls, folder: Path, info: RunInfo) -> Self:
        """Return what an interrupted run of the same task has saved in ``folder``.

        It may have ended before its first save, or between the renaming of two files, so that one
        of them holds episodes that the other lacks; these are played again.

        Raises:
            ReadError: if a saved file is damaged.
        """
        if not all((folder / name).exists() for name in (EPISODES_FILE, ACTIONS_FILE)):
            return cls(folder, info)
        rows = _read_rows(folder / EPISODES_FILE)
        seeds, actions = _read_actions(folder / ACTIONS_FILE)
        both = set(seeds).intersection(row["seed"] for row in rows)
        kept_rows = [row for row in rows if row["seed"] in both]
        kept_actions = [log for seed, log in zip(seeds, actions, strict=True) if seed in both]
        _check_logs(folder / ACTIONS_FILE, kept_rows, kept_actions)
        return cls(folder, info, tuple(kept_rows), tuple(kept_actions))

    def plus(self, episodes: Sequence[Episode]) -> Self:
        """Return these results with further ``episodes``, in the order of the split."""
        rows = [*self.rows, *map(episode_row, episodes)]
        actions = [*self.actions, *(np.array(episode.action, np.float32) for episode in episodes)]
        order = sorted(range(len(rows)), key=lambda i: rows[i]["seed"])
        return replace(
            self,
            rows=tuple(rows[i] for i in order),
            actions=tuple(actions[i] for i in order),
        )

    @property
    def seeds(self) -> set[int]:
        """Seeds of the episodes."""
        return {row["seed"] for row in self.rows}

    @cached_property
    def conditions(self) -> dict[str, str]:
        """The values of ``CONDITIONS``, as tables print them.

        ``inference`` is ``sync`` if the world waited for the policy, else such as ``async 150 ms``.
        """
        played = flat(self.info.recipe)
        values = {name: _shown(played[name]) for name in COMPARED}
        return values | {"inference": self.info.extra.get("inference") or SYNC}

    @property
    def privileged(self) -> bool:
        """Whether who moved the hand saw the simulator's state."""
        return bool(self.info.extra.get("privileged"))

    def marked(self, name: str) -> str:
        """Return a name of the policy as tables and reports show it: marked if it is privileged."""
        return f"{name} (privileged)" if self.privileged else name

    @cached_property
    def summary(self) -> Summary:
        """Every metric with its interval over all episodes."""
        return summarize_rows(self.rows)

    def by(self, stratum: str) -> dict[str, Summary]:
        """Return every metric for every label of ``stratum``; computed once."""
        if stratum not in self._by:
            self._by[stratum] = summarize_by(self.rows, stratum)
        return self._by[stratum]

    def recipe(self) -> Recipe:
        """Return the recipe that was played; ReadError if it names something unknown here."""
        with reading(self.folder / METRICS_FILE):
            return validated(Recipe, self.info.recipe)

    def log(self, index: int) -> ActionLog:
        """Return what row ``index`` was played with."""
        row = self.rows[index]
        return ActionLog(row["seed"], self.actions[index], row["attempts"])

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``metrics.json``: per metric its value, interval, unit and count.

        A metric that applies to no episode has the value None and the count 0. ``n_success`` and
        ``pc_success_ci95``, Wilson's interval in percent, are named as in LeRobot.
        """
        info = self.info
        names = measured(self.rows)
        n_success = sum(row["success"] for row in self.rows)
        return {
            "schema": SCHEMA,
            "n": len(self.rows),
            "n_success": n_success,
            "pc_success_ci95": [100 * end for end in wilson(n_success, len(self.rows))],
            "split": info.split,
            "policy": info.policy,
            "capture": info.capture,
            "metrics": _plain(self.summary, names),
            "per_kind": {kind: _plain(summary, names) for kind, summary in self.by("kind").items()},
            "recipe": info.recipe,
            "code": info.code,
            "benchmark": info.benchmark,
            "command": info.command,
            "extra": info.extra,
        }

    def write(self) -> None:
        """Write the three files; ``metrics.json`` is renamed last, so it is there only if the
        others are.

        Raises:
            ValueError: if there is no episode.
        """
        if not self.rows:
            raise ValueError("no episode was recorded; results need at least one")
        text = json.dumps(self.as_json(), indent=2, allow_nan=False) + "\n"
        write_atomically(
            {
                self.folder / EPISODES_FILE: lambda path: _write_rows(path, self.rows),
                self.folder / ACTIONS_FILE: lambda path: _write_actions(
                    path, self.rows, self.actions
                ),
                self.folder / METRICS_FILE: lambda path: path.write_text(text, encoding="utf-8"),
            }
        )


@contextmanager
def kept_results(folder: Path | None, info: RunInfo) -> Iterator[Results]:
    """Hold a result folder, if there is one, and give what an interrupted run of the same task has
    saved in it.

    Raises:
        BlockingIOError, FileExistsError: if the folder is not to be had, see ``working_folder``.
        ReadError: if a saved file is damaged.
    """
    with working_folder(folder, info.task()) if folder else nullcontext():
        yield Results.resumed(folder, info) if folder else Results(Path(), info)


def saved_extra(folder: Path | None) -> dict[str, Any]:
    """Return ``RunInfo.extra`` of what an interrupted run has saved; nothing if it saved nothing.

    Raises:
        ReadError: if the saved file is damaged.
    """
    if folder is None or not (folder / METRICS_FILE).exists():
        return {}
    return _read_head(folder / METRICS_FILE)["extra"]


def read_results(folder: Path) -> Results:
    """Read a result folder.

    A metric in it that is not registered here is left out, with a warning that names it; one that
    is registered and not in it is missing in the rows.

    Raises:
        ReadError: one sentence that names the missing or damaged part, or says that it is of
            another schema.
    """
    folder = Path(folder)
    with reading(folder):
        for name in (METRICS_FILE, EPISODES_FILE, ACTIONS_FILE):
            if not (folder / name).exists():
                raise ReadError(f"{folder} holds no results: {name} is missing; {REMEDY}")
    head = _read_head(folder / METRICS_FILE)
    rows = _read_rows(folder / EPISODES_FILE)
    seeds, actions = _read_actions(folder / ACTIONS_FILE)
    if not head["n"] == len(rows) > 0:
        counts = f"{METRICS_FILE} {head['n']}, {EPISODES_FILE} {len(rows)}"
        raise ReadError(f"the files in {folder} disagree on the episodes: {counts}; {REMEDY}")
    if seeds != [row["seed"] for row in rows]:
        raise ReadError(
            f"{folder / ACTIONS_FILE} cannot be read: its seeds are not those of {EPISODES_FILE}"
        )
    _check_logs(folder / ACTIONS_FILE, rows, actions)
    info = RunInfo(**{entry.name: head[entry.name] for entry in fields(RunInfo)})
    played = flat(info.recipe) | {"benchmark": info.benchmark}
    for name in {"benchmark", *COMPARED}.intersection(COLUMNS):
        values = sorted({played[name], *(row[name] for row in rows)})
        if len(values) > 1:
            raise ReadError(
                f"{folder} holds episodes of {name} {values[0]!r} and {values[1]!r}; {REMEDY}"
            )
    return Results(folder, info, tuple(rows), tuple(actions), head)


def finished(results: Results) -> Results:
    """Return results that hold every episode that was asked for.

    Raises:
        ReadError: if the evaluation is unfinished.
    """
    asked = results.info.extra.get("episodes_asked", 0)
    if len(results.rows) < asked:
        raise ReadError(
            f"{results.folder} is unfinished, with {len(results.rows)} of {asked} episodes; "
            f"{REMEDY}"
        )
    return results


def _shown(value: Any) -> str:
    """Return a value of a recipe that anybody may have written; an empty list is the default."""
    if isinstance(value, list | tuple):
        return ", ".join(value) or "default"
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _plain(summary: Summary, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    return {name: asdict(summary[name]) for name in names}


# -- the three files -------------------------------------------------------------------------------


def _read_head(path: Path) -> dict[str, Any]:
    with reading(path):
        head = {"extra": {}} | read_object(path)
        require_schema(path, head, SCHEMA, OTHER_SCHEMA)
        require(head, HEAD_TYPES)
        # not made a Recipe here, which would need every plugin that it names
        require(head["recipe"], get_type_hints(Recipe) | {"rules": dict[str, Any]})
        require(head["recipe"]["rules"], get_type_hints(Rules))
        require(
            head["extra"],
            {name: kind for name, kind in EXTRA_TYPES.items() if name in head["extra"]},
        )
        return head


def _write_rows(path: Path, rows: Sequence[Row]) -> None:
    import pyarrow as pa
    import pyarrow.json as pj
    import pyarrow.parquet as pq

    # arrow takes Python's lists through pandas, whose import takes longer than an episode
    lines = "\n".join(map(json.dumps, rows)).encode()
    schema = pa.schema(COLUMNS | dict.fromkeys(measured(rows), METRIC_TYPE))
    options = pj.ParseOptions(explicit_schema=schema, unexpected_field_behavior="ignore")
    pq.write_table(pj.read_json(io.BytesIO(lines), parse_options=options), path, compression="none")


def _read_rows(path: Path) -> list[Row]:
    import pyarrow as pa

    with reading(path):
        with open_table(path) as file:
            names = file.schema_arrow.names
        columns = COLUMNS | dict.fromkeys(measured([dict.fromkeys(names)]), METRIC_TYPE)
        unknown = sorted(set(names) - columns.keys())
        if unknown:
            warnings.warn(
                f"{path}: {', '.join(map(printable, unknown))} is no metric that is registered "
                f"here, and is left out; install the package that registers it to read it",
                LeftOut,
                stacklevel=3,
            )
        rows = list(read_rows(path, pa.schema(columns)))
        for row in rows:
            for name, kind in columns.items():
                if not _possible(name, kind, row[name]):
                    raise ValueError(f"it says {name} of an episode is {row[name]!r:.80}")
        return rows


def _possible(name: str, kind: str, value: Any) -> bool:
    """Tell whether an episode could have a value in a column; a metric may lack one."""
    if name in METRICS:
        return value is None or (METRICS[name].admits(value) and value <= LARGEST)
    if value is None:
        return name == "first_localized"
    return kind not in ("double", "int64") or 0 <= value <= LARGEST


def _write_actions(path: Path, rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    with path.open("wb") as file:  # an open file, because numpy appends .npz to a path
        np.savez(
            file,
            action=np.concatenate(list(actions)).reshape(-1, HAND_DOF),
            offsets=np.cumsum([0, *map(len, actions)]),
            seed=np.array([row["seed"] for row in rows], np.int64),
            window_frames=np.array([row["window_frames"] for row in rows], np.int64),
        )


def _read_actions(path: Path) -> tuple[list[int], list[np.ndarray]]:
    """Return the seed and the (T, 18) actions of every episode."""
    with reading(path):
        actions, offsets, seeds = read_arrays(path, ("action", "offsets", "seed")).values()
        if (
            actions.shape[1:] != (HAND_DOF,)
            or actions.dtype.kind != "f"
            or not (np.abs(actions) <= LARGEST).all()
        ):
            given = f"of shape {actions.shape}, up to {np.abs(actions).max(initial=0)}"
            raise ValueError(
                f"its actions must be of shape (N, {HAND_DOF}), up to {LARGEST}; they are {given}"
            )
        logs = np.split(actions, offsets[1:-1])
        if len(logs) != len(seeds) or not np.array_equal(np.cumsum([0, *map(len, logs)]), offsets):
            raise ValueError("its offsets do not divide its actions among its episodes")
        return seeds.tolist(), logs


def _check_logs(path: Path, rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    """Raise a ReadError if an episode has fewer actions than its row says it lasted."""
    with reading(path):
        for row, log in zip(rows, actions, strict=True):
            for name in ("window_frames", "first_localized"):
                if (row[name] or 0) >= len(log):
                    raise ValueError(
                        f"seed {row['seed']} has {len(log)} commands, and {name} is {row[name]}"
                    )
