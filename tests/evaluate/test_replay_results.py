"""Results replay if their logged commands lead to them, and only then."""

import hashlib
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.replay_results import drawn
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.rollout.loop import replay
from tests.synthetic import write_results
from tests.tools import dynahoi, edit_json


def rewritten(folder: Path, **changes: object) -> None:
    """Write results again with other contents, its sums made to fit."""
    results: Results = replace(read_results(folder), **changes)
    results.write()


def set_head(**changes: object) -> Callable[[Path], None]:
    """Return a function that changes ``metrics.json``."""
    return lambda folder: edit_json(folder / "metrics.json", **changes)


def better_sum(folder: Path) -> None:
    edit_json(folder / "metrics.json", lambda head: head["metrics"]["E_loc"].update(value=0.1))


def better_row(folder: Path) -> None:
    rows = read_results(folder).rows
    rewritten(folder, rows=(rows[0] | {"E_loc": rows[0]["E_loc"] / 2}, *rows[1:]))


def moved(row: int, last: int, offset_m: float) -> Callable[[Path], None]:
    """Return a function that moves the last commands of a row."""

    def change(folder: Path) -> None:
        actions = [commands.copy() for commands in read_results(folder).actions]
        actions[row][-last:, :3] += offset_m
        rewritten(folder, actions=tuple(actions))

    return change


def easy_seed_twice(folder: Path) -> None:
    results = read_results(folder)
    rewritten(folder, rows=(results.rows[0],) * 2, actions=(results.actions[0],) * 2)


def another_version(folder: Path) -> None:
    results = read_results(folder)
    rows = tuple(row | {"benchmark": "v9"} for row in results.rows)
    rewritten(folder, rows=rows, info=replace(results.info, benchmark="v9"))


def other_code(folder: Path) -> None:
    results = read_results(folder)
    code = "0123456789abcdef"
    rows = tuple(row | {"code": code} for row in results.rows)
    rewritten(folder, rows=rows, info=replace(results.info, code=code))


def more_attempts(folder: Path) -> None:
    results = read_results(folder)
    unmarked = replace(results.info, extra=results.info.extra | {"privileged": False})
    rewritten(folder, rows=(results.rows[0] | {"attempts": 3}, *results.rows[1:]), info=unmarked)


def longer_logs(folder: Path) -> None:
    """Give every hand more time than an evaluation does, and write what that leads to."""
    results = read_results(folder)
    logs = [results.log(i) for i in range(len(results.rows))]
    longer = [
        replace(log, actions=np.concatenate([log.actions, log.actions[-1:].repeat(60, 0)]))
        for log in logs
    ]
    write_results(folder, replay(results.recipe(), longer, images=False), results.info)


FORGERIES: list[tuple[Callable[[Path], None], str]] = [
    (better_sum, " over the episodes"),
    (better_row, "seed {0}: E_loc is "),
    (moved(row=1, last=20, offset_m=0.01), "seed {1}: "),
    (moved(row=2, last=1, offset_m=1.0), "seed {2}: "),
    (easy_seed_twice, "seed {0} is there 2 times"),
    (more_attempts, "seed {0} took 3 attempts"),
    (longer_logs, "an evaluation with them"),
    (another_version, "are of benchmark v9"),
    (set_head(split="val"), "names split val"),
    (set_head(code="0123456789abcdef"), "metrics.json names 0123456789abcdef"),
]
"""What is done to a result, and what is found; ``{i}`` stands for the seed of row i."""


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes of a baseline that catches some."""
    folder = tmp_path_factory.mktemp("honest") / "results"
    dynahoi("evaluate", "--policy", "constant_velocity", "--episodes", "3", "--out", folder)
    return folder


def test_an_honest_result_replays_and_its_digests_are_told(honest: Path):
    said = dynahoi("evaluate", "--replay", honest).out
    for name in ("metrics.json", "episodes.parquet", "actions.npz"):
        assert hashlib.sha256((honest / name).read_bytes()).hexdigest() in said
    assert (
        said.count("not the benchmark's") == said.count("not the benchmark's privileged: True") == 1
    )


def test_results_of_other_code_are_replayed_with_a_word(honest: Path, tmp_path: Path):
    other = shutil.copytree(honest, tmp_path / "other")
    other_code(other)
    said = dynahoi("evaluate", "--replay", other).out
    assert "made by other code" in said
    assert "every number is the same" in said


def test_what_results_say_begins_no_line_of_a_replay(honest: Path, tmp_path: Path):
    other = shutil.copytree(honest, tmp_path / "other")
    end = "\nevery number is the same"

    def forge(head: dict) -> None:
        head["extra"]["surroundings"] = {"numpy": end}
        head["per_kind"][end] = head["metrics"]

    edit_json(other / "metrics.json", forge, code="0123456789abcdef")
    lines = dynahoi("evaluate", "--replay", other, code=1).out.splitlines()
    assert not [line for line in lines if line.startswith(end.strip())]


def test_a_drawn_sample_can_be_drawn_again(honest: Path):
    words = ["evaluate", "--replay", honest, "--episodes", "1"]
    first = dynahoi(*words).out
    (seed,) = re.findall(r"--replay-seed (\d+)", first)
    assert dynahoi(*words, "--replay-seed", seed).out == first
    assert len(set(drawn(1000, 44, 0))) == 44
    assert drawn(1000, 44, 0) != drawn(1000, 44, 1)


def test_easier_rules_are_named(tmp_path: Path):
    words = ["evaluate", "--policy", "hold", "--episodes", "2", "--out", tmp_path / "easy"]
    dynahoi(*words, "--motions", "constant", "--protocol", "direct_act")
    said = dynahoi("evaluate", "--replay", tmp_path / "easy").out
    assert "not the benchmark's motions: ['constant']" in said
    assert "not the benchmark's protocol: 'direct_act'" in said


@pytest.mark.parametrize(("forge", "finding"), FORGERIES)
def test_a_forged_result_is_found(honest, tmp_path, forge, finding):
    folder = tmp_path / "forged"
    shutil.copytree(honest, folder)
    forge(folder)
    said = dynahoi("evaluate", "--replay", folder, code=1).out
    assert finding.format(*(row["seed"] for row in read_results(honest).rows)) in said
    assert "not the same" in said


def test_results_of_a_salt_are_replayed_by_who_knows_it(tmp_path: Path):
    secret = "a secret of sixteen letters"
    folder = tmp_path / "results"
    dynahoi("evaluate", "--policy", "hold", "--episodes", "2", "--salt", secret, "--out", folder)
    dynahoi("evaluate", "--replay", folder, "--salt", secret)
    for salt in ("", "another one of sixteen letters"):
        said = dynahoi("evaluate", "--replay", folder, "--salt", salt, code=2).err
        assert "the results are of salt sha256:" in said
        assert secret not in said
