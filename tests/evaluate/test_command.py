"""``dynahoi evaluate`` works in folders of its own, alone, and loses nothing when it is
interrupted.
"""

import errno
import json
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.report.entries import read_entries
from tests.checkpoints import tiny_diffusion
from tests.tools import dynahoi

HOLD = ["evaluate", "--policy", "hold", "--episodes", "2"]


@pytest.mark.parametrize("name", ["thesis.tex", "metrics.json"])
def test_files_of_somebody_else_stay_as_they_are(name: str, tmp_path: Path):
    (tmp_path / name).write_text("mine")
    assert name in dynahoi(*HOLD, "--out", tmp_path, code=2).err
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


def test_results_of_another_evaluation_stay_and_what_differs_is_named(tmp_path):
    dynahoi(*HOLD, "--out", tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for option, value in (
        ("policy", "pursuit"),
        ("split", "val"),
        ("control_class", "late"),
        ("render_noise", "2"),
        ("capture", "contact"),
    ):
        other = f"--{option.replace('_', '-')}={value}"
        assert option in dynahoi(*HOLD, other, "--out", tmp_path, code=2).err
    dynahoi(*HOLD, "--out", tmp_path, "--per-kind")  # it is finished
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_full_disk_is_one_sentence_and_the_run_resumes(tmp_path, monkeypatch):
    words = [*HOLD, "--episodes", "4", "--batch-size", "2", "--out", tmp_path]
    write = np.savez
    calls = []

    def full(*args: object, **arrays: np.ndarray) -> None:
        calls.append(len(arrays["seed"]))
        if len(calls) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(*args, **arrays)

    monkeypatch.setattr(np, "savez", full)
    assert "No space left on device" in dynahoi(*words, code=1).err
    assert len(read_results(tmp_path).rows) == 2, "what was saved before stays"
    assert not list(tmp_path.glob("*.part"))
    (tmp_path / ".actions.npz.1234.part").write_bytes(b"half of what a killed run wrote")
    dynahoi(*words)
    assert calls == [2, 4, 4]
    assert sorted(row["seed"] for row in read_results(tmp_path).rows) == [0, 1, 2, 3]
    assert not list(tmp_path.glob(".*.part"))


def test_a_report_leaves_an_unfinished_evaluation_out_until_it_is_finished_or_made_shorter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    words = [*HOLD, "--batch-size", "2", "--image-size", "0", "--out", tmp_path]
    write = Results.write

    def killed(results: Results) -> None:
        write(results)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Results, "write", killed)
        dynahoi(*words, "--episodes", "4", code=130)
    with pytest.raises(ReadError, match="is unfinished, with 2 of 4 episodes; run"):
        read_entries([tmp_path])
    for episodes in (2, 4):
        dynahoi(*words, "--episodes", episodes)
        (entry,) = read_entries([tmp_path])
        assert len(entry.results.rows) == episodes


def test_clips_are_of_the_first_episodes_of_the_split_whichever_end_first(tmp_path: Path):
    kinds = ["--motions", "random_spline,constant"]
    dynahoi(*HOLD, "--episodes=5", "--image-size=32", "--gifs=2", *kinds, "--out", tmp_path)
    seeds = {path.stem.rpartition("_")[2] for path in tmp_path.glob("*.gif")}
    assert seeds == {"0", "1"}


def test_an_episode_that_was_played_without_a_clip_gets_none_in_silence(tmp_path: Path):
    out = tmp_path / "my results"
    words = (*HOLD, "--motions=constant", "--image-size=32", "--out", out)
    dynahoi(*words, "--episodes=1")
    said = dynahoi(*words, "--episodes=2", "--gifs=1", code=2).err
    assert f"dynahoi view --results '{out}' --seed 0 --out FILE.gif" in said
    assert len(read_results(out).rows) == 1
    dynahoi("view", "--results", out, "--seed=0", "--out", out / "constant_0.gif")
    dynahoi(*words, "--episodes=2", "--gifs=2")
    assert len(list(out.glob("*.gif"))) == 2


def test_what_is_played_by_another_control_mode_is_stored_as_a_word(tmp_path: Path):
    out = tmp_path / "grasp"
    dynahoi(*HOLD, "--control-mode=grasp", "--image-size=0", "--out", out)
    head = json.loads((out / "metrics.json").read_text())
    assert head["recipe"]["rules"]["control_mode"] == "grasp"
    dynahoi("evaluate", "--replay", out)


def test_a_policy_that_samples_gives_the_same_rows_when_it_is_interrupted(
    tmp_path: Path, monkeypatch
):
    policy = tiny_diffusion(tmp_path / "policy")
    words = ["evaluate", f"--policy={policy}", "--environment-state=truth"]
    words += ["--episodes=5", "--batch-size=2", "--out"]
    dynahoi(*words, tmp_path / "whole")
    write = Results.write
    saves = []

    def killed(results: Results) -> None:
        write(results)
        saves.append(len(results.rows))
        if len(saves) in (1, 2):
            raise KeyboardInterrupt

    monkeypatch.setattr(Results, "write", killed)
    for code in (130, 130, 0):
        said = dynahoi(*words, tmp_path / "resumed", code=code).err
        assert ("; run the same command to resume" in said) == (code == 130)
    assert saves == [2, 4, 5]
    whole, resumed = (read_results(tmp_path / name) for name in ("whole", "resumed"))
    assert resumed.rows == whole.rows
    np.testing.assert_array_equal(np.concatenate(resumed.actions), np.concatenate(whole.actions))
