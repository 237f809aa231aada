"""Messages about broken files name the file, and numbers out of range come with the right range."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from dynahoi_lerobot.cli import main as cli

GARBAGE = b"{\xff"


def overwrite(pattern: str, content: bytes) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        for path in root.glob(pattern):
            path.write_bytes(content)

    return damage


def remove(name: str) -> Callable[[Path], None]:
    return lambda root: shutil.rmtree(root / name)


DAMAGES = {
    "truncated info": (overwrite("meta/info.json", b'{"features": '), "meta/info.json cannot be read"),
    "info without features": (
        overwrite("meta/info.json", b"{}"),
        "meta/info.json cannot be read (KeyError: 'features')",
    ),
    "manifest": (overwrite("meta/manifest.json", GARBAGE), "meta/manifest.json cannot be read"),
    "episode table": (overwrite("meta/episodes/*/*", GARBAGE), "file-000.parquet cannot be read"),
    "no episode table": (remove("meta/episodes"), "there is no file in meta/episodes"),
    "frame table": (overwrite("data/*/*", GARBAGE), "data/chunk-000/file-000.parquet cannot be read"),
    "no frame table": (remove("data"), "there is no file in data"),
    "video": (overwrite("videos/*/*/*", GARBAGE), "file-000.mp4"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_filter_names_the_damaged_file(
    damage: str, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken, (apply, sentence) = shutil.copytree(dataset, tmp_path / "broken"), DAMAGES[damage]
    apply(broken)
    assert cli.main(["filter", str(broken), "--out", str(tmp_path / "out")]) == cli.BAD_INPUT
    said = capsys.readouterr().err.strip()
    assert sentence in said
    assert str(broken) in said
    assert "\n" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["broken"]


GENERATE = ["generate", "--root", "made", "--episodes", "1", "--motions", "constant"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([*GENERATE, "--episodes", str(10**30)], f"episodes is {10**30}; it must be 1 to 5354228880"),
        ([*GENERATE, "--seed", str(2**40)], f"seed is {2**40}; it must be 0 to 5354228879 for 1 episodes"),
        ([*GENERATE, "--preset", "warp9"], "preset is 'warp9'; h264 has ultrafast"),
        ([*GENERATE, "--crf", "52"], "crf is 52; it must be 0 to 51"),
        ([*GENERATE, "--codec", "images", "--preset", "fast"], "preset is 'fast'; images has none"),
        ([*GENERATE, "--workers", "0"], "--workers: must be a whole number from 1 to 4096, got 0"),
        ([*GENERATE, "--recipe", "recipe.yaml"], "motions must be a list, got 'lob'; write [lob]"),
        (["evaluate", "--policy", "hold", "--out", "recipe.yaml"], "recipe.yaml is a file; remove it"),
        (["view", "--motion", "lob", "--seed", "46"], "has 45 episodes of motion 'lob', so --seed must be 0 to 44"),
        (["view", "--motion", "lob", "--seed", str(2**40)], f"a whole number from 0 to {2**40 - 1}, got {2**40}"),
        (["report", "recipe.yaml"], "recipe.yaml; run `dynahoi evaluate` with this folder"),
        (["dance"], "dynahoi: command: invalid choice: 'dance'"),
    ],
)  # fmt: skip
def test_a_sentence_names_what_was_received_and_what_is_allowed(
    words: list[str],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recipe.yaml").write_text("motions: lob\n")
    assert cli.main(words) == cli.BAD_INPUT
    said = capsys.readouterr().err.strip()
    assert sentence in said
    assert "\n" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.yaml"]


def test_a_tilde_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cli.main(["view", "--motion", "lob", "--image-size", "16", "--out=~/clips/lob.gif"]) == 0
    assert [path.name for path in (tmp_path / "home" / "clips").iterdir()] == ["lob.gif"]
    assert not (tmp_path / "~").exists()
