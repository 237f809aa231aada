"""Commands and programs in the pages can be typed as they stand there."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import importlib
import importlib.util
import subprocess
import sys
import typing
from collections.abc import Sequence
from pathlib import Path

import draccus
import pytest

from dynahoi_lerobot.cli.main import COMMANDS
from tests.docs.documents import ROOT, Page, pages

LINES = sorted({tuple(words) for page in pages() for words in page.commands})
SPANS = sorted({span for page in pages() for span in page.spans if span.startswith("--")})
LEROBOT = {
    "lerobot-train": ("lerobot.configs.train", "TrainPipelineConfig"),
    "lerobot-eval": ("lerobot.configs.eval", "EvalPipelineConfig"),
    "lerobot-edit-dataset": ("lerobot.scripts.lerobot_edit_dataset", "EditDatasetConfig"),
}
STUDIES = "recipes/study/run.py"
PLUGINS = ("lerobot_env_dynahoi", "lerobot_policy_tracker", "lerobot_policy_actiontokens", "lerobot.policies.factory")
PARSER_OPTIONS = ("config_path", "path", "type", "discover_packages_path")
"""Options of LeRobot's parser itself, of any config or of any choice."""


def of(program: str) -> list[tuple[str, ...]]:
    return [words for words in LINES if words[0] == program]


def options(words: Sequence[str]) -> list[str]:
    """Return the options of a command line, without their values."""
    return [word.partition("=")[0] for word in words if word.startswith("--")]


def test_the_pages_show_commands():
    assert len(of("dynahoi")) > 10
    assert of("lerobot-train")
    assert of("python")


@pytest.mark.parametrize("words", of("dynahoi"), ids=" ".join)
def test_dynahoi_commands_have_the_options_shown(words: tuple[str, ...]):
    assert words[1] in COMMANDS
    assert not set(options(words)) - _dynahoi_options(words[1])


@pytest.mark.slow  # LeRobot and its policies take long to import
@pytest.mark.parametrize("words", [words for name in LEROBOT for words in of(name)], ids=" ".join)
def test_lerobot_commands_have_the_options_shown(words: tuple[str, ...]):
    chosen = dict(word[2:].split("=", 1) for word in words if word.startswith("--"))
    config = _lerobot_config(words[0])
    assert not [name for name in options(words) if not _has(config, name[2:].split("."), chosen)]


@pytest.mark.slow
@pytest.mark.parametrize("span", SPANS)
def test_options_named_in_the_text_exist_in_some_command(span: str):
    (option,) = options(span.split()[:1])
    known = any(option in _dynahoi_options(command) for command in COMMANDS) or f" {option} " in _help(STUDIES)
    assert known or any(_has(_lerobot_config(name), option[2:].split("."), {}) for name in LEROBOT)


@pytest.mark.slow
@pytest.mark.parametrize("words", of("python"), ids=" ".join)
def test_python_programs_have_the_options_shown(words: tuple[str, ...]):
    if words[1] == "-m":
        assert importlib.util.find_spec(words[2])
    else:
        assert not [option for option in options(words) if option not in _help(words[1])]


@pytest.mark.slow
@pytest.mark.parametrize("words", of("accelerate"), ids=" ".join)
def test_accelerate_starts_lerobots_training_with_options_that_both_have(words: tuple[str, ...]):
    split = words.index("-m")
    parser = importlib.import_module("accelerate.commands.launch").launch_command_parser()
    assert not set(options(words[:split])) - set(parser._option_string_actions)
    assert words[split + 1] == "lerobot.scripts.lerobot_train"
    test_lerobot_commands_have_the_options_shown(("lerobot-train", *words[split + 2 :]))


@pytest.mark.slow
@pytest.mark.parametrize("words", of("lerobot-dataset-viz"), ids=" ".join)
def test_lerobots_viewer_has_the_options_shown(words: tuple[str, ...]):
    run = [sys.executable, "-m", "lerobot.scripts.lerobot_dataset_viz", "--help"]
    told = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    assert not [option for option in options(words) if f"{option} " not in told]


@pytest.mark.parametrize("page", [ROOT / "README.md"], ids=["README.md"])
def test_python_blocks_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    blocks = Page.read(page).blocks("python")
    assert blocks
    for block in blocks:
        exec(compile(block, str(page), "exec"), {})


@functools.cache
def _dynahoi_options(command: str) -> frozenset[str]:
    parser = argparse.ArgumentParser()
    importlib.import_module(COMMANDS[command][0]).add_arguments(parser)
    return frozenset(parser._option_string_actions)


@functools.cache
def _lerobot_config(program: str) -> type:
    for plugin in PLUGINS:
        importlib.import_module(plugin)
    module, name = LEROBOT[program]
    return getattr(importlib.import_module(module), name)


def _has(config: type, path: list[str], chosen: dict[str, str], prefix: str = "") -> bool:
    """Tell whether a config, or the choice made by ``--prefix.type``, has the option ``path``."""
    name, *rest = path
    if name in PARSER_OPTIONS and not rest:
        return True
    for variant in _variants(config, chosen.get(f"{prefix}type")):
        if name in {field.name for field in dataclasses.fields(variant)}:
            inner = typing.get_type_hints(variant)[name]
            parts = [part for part in (inner, *typing.get_args(inner)) if dataclasses.is_dataclass(part)]
            if not rest or any(_has(part, rest, chosen, f"{prefix}{name}.") for part in parts):
                return True
    return False


def _variants(config: type, kind: str | None) -> list[type]:
    if not issubclass(config, draccus.ChoiceRegistry):
        return [config]
    known = config.get_known_choices()
    return [known[kind]] if kind else [config, *known.values()]


@functools.cache
def _help(script: str) -> str:
    run = [sys.executable, str(ROOT / script), "--help"]
    return subprocess.run(run, capture_output=True, text=True, check=True, cwd=ROOT).stdout
