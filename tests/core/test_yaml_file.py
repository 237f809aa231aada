"""Hostile recipe files are refused in one sentence and at once, also by the command that reads them."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import BAD_INPUT, main
from dynahoi_lerobot.core.yaml_file import MAX_BYTES, MAX_DEPTH, read_yaml
from dynahoi_lerobot.sampling.recipe import load_recipe

LIMIT_S = 2.0


def alias_bomb(levels: int = 9) -> bytes:
    """Return a list of 10 to the power of ``levels`` words in a few lines."""
    lines = ["  - &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"  - &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, levels)]
    return "\n".join(["motions:", *lines]).encode()


HOSTILE = {
    "an alias bomb": (alias_bomb(), "anchors and aliases are not allowed, got 'a0' in line 2"),
    "an alias to itself": (b"motions: &a [*a]", "anchors and aliases are not allowed, got 'a' in line 1"),
    "deep lists": (b"motions: " + b"[" * 20_000, f"values may be nested {MAX_DEPTH} deep, got more in line 1"),
    "deep mappings": (b"{a: " * 9_000, f"values may be nested {MAX_DEPTH} deep, got more in line 1"),
    "deep blocks": (b"-\n" + b"".join(b" " * i + b"-\n" for i in range(1, 300)), "got more in line 17"),
    "20 megabytes": (b"motions: [" + b"lateral, " * 2_300_000 + b"]", f"has more than the {MAX_BYTES:,} bytes"),
    "another encoding": (b"split: tr\xe4in", "is not YAML: 'utf-8' codec can't decode byte 0xe4"),
    "a number of 5,000 digits": (b"image_size: " + b"9" * 5_000, "is not YAML: Exceeds the limit"),
    "a month too many": (b"split: 2024-13-01", "is not YAML: month must be in 1..12"),
    "a key twice": (b"split: train\nsplit: test", "key 'split' appears again in line 2"),
    "an object of Python": (b"split: !!python/object/apply:os.getcwd []", "is not YAML: could not determine a constr"),
    "two documents": (b"split: train\n---\nsplit: test", "is not YAML: expected a single document"),
    "no mapping": (b"false", "must map keys to values, got a bool"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_recipe_is_refused_at_once(name: str, tmp_path: Path):
    content, message = HOSTILE[name]
    path = tmp_path / "recipe.yaml"
    path.write_bytes(content)
    begin = time.process_time()
    with pytest.raises(ValueError) as error:  # noqa: PT011  (the message is looked at below)
        load_recipe(path)
    assert time.process_time() - begin < LIMIT_S
    assert message in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_the_command_says_it_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "recipe.yaml"
    path.write_bytes(alias_bomb())
    words = ["--root", str(tmp_path / "d"), "--episodes", "1", "--recipe", str(path)]
    assert main(["generate", *words]) == BAD_INPUT
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "d").exists()


def test_a_folder_is_not_read(tmp_path: Path):
    with pytest.raises(ValueError, match="cannot be read: Is a directory"):
        read_yaml(tmp_path)


def test_what_is_plain_is_read(tmp_path: Path):
    path = tmp_path / "plain.yaml"
    path.write_text("# a comment\nmotions: [lateral, ramp]\nimage_size: 64\nsalt: null\nwords: {a: [1.5, true]}\n")
    values = {"motions": ["lateral", "ramp"], "image_size": 64, "salt": None, "words": {"a": [1.5, True]}}
    assert read_yaml(path) == values
