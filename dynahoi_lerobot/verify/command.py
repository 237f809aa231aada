"""``dynahoi verify``: run every check on a dataset on disk and print the findings."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from tqdm import tqdm

from dynahoi_lerobot.core.arguments import argument, option, whole
from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.core.reading import ReadError, reading, validated
from dynahoi_lerobot.dataset.manifest import ENCODED, Manifest, has_own_card
from dynahoi_lerobot.dataset.paths import CARD_PATH, MANIFEST_PATH
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.verify.files import edited, file_problems, unreadable
from dynahoi_lerobot.verify.format import (
    column_problems,
    format_problems,
    manifest_problems,
    statistics_problems,
)
from dynahoi_lerobot.verify.replay import replay_problems, seed_problems
from dynahoi_lerobot.verify.verdicts import derived_problems, verdict_problems

SHOWN = 5
"""Findings of a claim that are reported; the rest are counted."""
LONGEST = 600
"""Characters of a finding that are shown."""


@dataclass(frozen=True)
class Finding:
    """Something wrong with a dataset.

    Attributes:
        check: the claim that it refutes: ``files``, ``format``, ``seeds``, ``verdicts`` or
            ``replay``.
        message: what is wrong, where, and what was expected.
    """

    check: str
    message: str

    def __str__(self) -> str:
        """Return both on one line, with what cannot be printed escaped: it may come from a hostile
        dataset.
        """
        return printable(f"{self.check}: {self.message}"[:LONGEST])


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi verify``."""

    root: Path = argument("dataset folder")
    replay: int = option(
        3,
        "number of random episodes to play again from their seeds and compare, including images; "
        "0 replays none",
        whole(0, 10**9),
    )
    json: Path | None = option(None, "also write the findings to this file")


def run(options: Options) -> int:
    """Verify a dataset and print the findings; return the exit code: 0 no findings, 1 findings."""
    try:
        episodes = Store(options.root).info.get("total_episodes")
    except ValueError:
        episodes = None  # a finding
    with tqdm(
        total=episodes if isinstance(episodes, int) else None, unit="episode", disable=None
    ) as bar:
        findings = verify(
            options.root,
            replayed=options.replay,
            progress=bar.update,
            note=lambda sentence: print(printable(sentence)),
        )
    for finding in findings:
        print(finding)
    told = f"{len(findings)} findings" if findings else f"{episodes} episodes, no findings"
    print(f"{options.root}: {told}")
    if options.json:
        options.json.write_text(json.dumps([asdict(finding) for finding in findings], indent=2))
    return 1 if findings else 0


@np.errstate(all="ignore")  # what a hostile dataset holds is a finding, no warning
def verify(
    root: Path,
    *,
    replayed: int = 0,
    progress: Callable[[], object] = lambda: None,
    note: Callable[[str], object] = lambda _: None,
) -> list[Finding]:
    """Check the claims about a dataset.

    Args:
        root: the dataset's folder.
        replayed: how many episodes are played again from their seeds and compared; they are drawn
            at random. Without a recording in the manifest, or with a secret salt, none can be; that
            the recording names something unknown here is a finding if any is asked for.
        progress: called after each episode whose verdict was checked.
        note: told in a sentence what a replay found equal, and what could not be checked.

    Returns:
        At most ``SHOWN`` findings per claim and a count of the rest; empty if all claims hold. If a
        table cannot be read, that alone; if another tool has written the dataset, that, and what
        LeRobot's format finds wrong.

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if a negative number of episodes is to be replayed.
    """
    if replayed < 0:
        raise ValueError(f"the number of episodes to replay is {replayed}; it must be 0 or more")
    store = Store(root)
    try:
        manifest = Manifest.read(root) if (root / MANIFEST_PATH).exists() else None
    except ValueError as error:
        return [Finding("files", str(error)), *_guarded("files", unreadable(store))]
    findings = _guarded("files", file_problems(store, manifest))
    broken = _guarded("files", unreadable(store))
    if broken:
        return broken + findings
    sentence = edited(store, manifest)
    if sentence is not None or manifest is None:
        findings.append(Finding("files", str(sentence)))
        return findings + _guarded("format", format_problems(store, note))
    if CARD_PATH in manifest.files and not has_own_card(root, manifest):
        note(f"{CARD_PATH} is not the one that was written with the dataset, so it was not checked")
    encoded = ENCODED in manifest.provenance
    problems = [format_problems(store, note), manifest_problems(store, manifest)]
    if encoded:
        note("its images were encoded: check and replay the dataset that it was made from, too")
    else:
        problems += [column_problems(store), statistics_problems(store)]
    findings += _guarded("format", chain.from_iterable(problems))
    replayed = 0 if encoded else replayed
    fail = (lambda said: findings.append(Finding("replay", said))) if replayed else note
    recording = _recording(manifest, note, fail)
    if recording is not None:
        findings += _guarded("seeds", seed_problems(store, manifest, recording, note))
    findings += _guarded("verdicts", _verdicts(store, recording, progress))
    if recording is not None and not recording.recipe.salt and replayed:
        findings += _guarded("replay", _replay(store, recording, replayed, note))
    return findings


def _replay(
    store: Store, recording: Recording, count: int, note: Callable[[str], object]
) -> Iterator[str]:
    drawn = drawn_evenly(store, count, np.random.default_rng())
    note(f"replaying the episodes {', '.join(map(str, drawn))}")
    yield from replay_problems(store, drawn, recording, note)


def _verdicts(
    store: Store, recording: Recording | None, progress: Callable[[], object]
) -> Iterator[str]:
    hand = recording.recipe.rules.hand_name if recording else None
    for stored in store.stored_episodes():
        where = f"episode {stored.row['episode_index']}: "
        try:
            episode = store.as_episode(stored, images=False)
            problems = [
                *verdict_problems(episode, hand),
                *derived_problems(store.features, stored.frames, episode),
            ]
        except (LookupError, ValueError, TypeError) as error:
            problems = [f"it cannot be judged: {type(error).__name__}: {error}"]
        yield from (where + problem for problem in problems)
        progress()


def _recording(
    manifest: Manifest, note: Callable[[str], object], fail: Callable[[str], object]
) -> Recording | None:
    """Return the recording that the manifest names; ``note`` is told that it names none, ``fail``
    what in it is unknown here.
    """
    nothing = "nothing was compared with the seeds, or played again"
    try:
        with reading(Path(MANIFEST_PATH)):
            stored = manifest.provenance.get("recording")
            if stored is not None:
                return validated(Recording, stored)
    except ReadError as error:
        fail(f"{error}; so {nothing}; if a name is unknown, install the package that registers it")
    else:
        note(f"no recording is known, so {nothing}")
    return None


def drawn_evenly(store: Store, count: int, rng: np.random.Generator) -> list[int]:
    """Return ``count`` indices of episodes (all if there are fewer), divided evenly among the kinds
    of motion.
    """
    turns: Counter[str] = Counter()
    ranked = []
    for index in rng.permutation(store.episodes).tolist():
        motion = store.rows[index]["motion"]
        ranked.append((turns[motion], index))
        turns[motion] += 1
    return sorted(index for _, index in sorted(ranked, key=lambda pair: pair[0])[:count])


def _guarded(name: str, problems: Iterable[str]) -> list[Finding]:
    """Collect what one check finds, the first few; an exception in a check is a finding, too."""
    found: list[str] = []
    try:
        found.extend(problems)
    except Exception as error:  # whatever a hostile dataset makes a reader raise
        found.append(f"cannot be checked: {error or type(error).__name__}")
    more = [f"and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    return [Finding(name, message) for message in [*found[:SHOWN], *more]]
