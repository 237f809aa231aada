"""Every damage of the table is found by the mode that the table names, and by no cheaper one."""

from __future__ import annotations

import argparse
import functools
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from docs.scripts import damage_table

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify import command
from tests.verify.damages import DAMAGES
from tests.verify.forgery import OTHER_VIDEO, sign

RECIPE = Recipe(motions=("constant", "lob", "planar"), image_size=32, hold_frames=12)
MODES = {"unsigned": ["--decode", "0"], "default": ["--decode", "0"], "decode": ["--decode", "all"]}
MODES["replay"] = ["--decode", "all", "--replay", "2"]


@pytest.fixture(scope="module")
def intact(tmp_path_factory) -> Path:
    """Six simulated episodes in two video files."""
    root = tmp_path_factory.mktemp("intact") / "d"
    limits = FileLimits(video_s=6.0)  # each shard's three episodes take 5.2 s
    generate(GenerationPlan(RECIPE, 6, shard_episodes=3, limits=limits), root, record=record)
    assert (root / OTHER_VIDEO).exists()
    return root


@pytest.fixture(scope="module")
def resimulate() -> Callable[[int], Episode | None]:
    """The simulator, which plays each seed once for all tests."""
    return functools.cache(lambda seed: next(record(RECIPE, [seed]), None))


@pytest.fixture
def findings(capsys, resimulate) -> Callable[[Path, str], str]:
    """Returns what the command prints in a mode, empty if it finds nothing."""

    def run(root: Path, mode: str) -> str:
        parser = argparse.ArgumentParser()
        command.add_arguments(parser)
        code = command.run(parser.parse_args([str(root), *MODES[mode]]), resimulate=resimulate)
        printed = capsys.readouterr().out
        assert code == ("no findings" not in printed)
        return printed if code else ""

    return run


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_found(intact, tmp_path, findings, name):
    damage, mode, words = DAMAGES[name]
    root = shutil.copytree(intact, tmp_path / "d")
    damage(root)
    if mode != "unsigned":
        sign(root)
    if mode in ("decode", "replay"):
        assert not findings(root, "default"), "a cheaper mode finds it"
    assert words in findings(root, mode)


def test_the_intact_dataset_has_no_findings(intact, findings):
    assert all(not findings(intact, mode) for mode in MODES)


def test_the_page_shows_these_damages():
    page = damage_table.PAGE.read_text()
    assert page == damage_table.with_table(page), "run: uv run python -m docs.scripts.damage_table"
