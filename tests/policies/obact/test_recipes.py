"""Every recipe is one that LeRobot, or our generator, reads as it stands."""

from __future__ import annotations

from pathlib import Path

import draccus
import pytest
import yaml
from lerobot.configs.train import TrainPipelineConfig
from lerobot.policies.factory import get_policy_class
from lerobot.utils.import_utils import register_third_party_plugins

from dynahoi_lerobot.recipe import load_recipe

RECIPES = Path(__file__).parents[3] / "recipes"
STUDY = RECIPES / "study" / "cpu.yaml"
TRAINING = sorted(
    [
        *RECIPES.glob("train/*.yaml"),
        *RECIPES.glob("zoo/*.yaml"),
        *(p for p in RECIPES.glob("study/*.yaml") if p != STUDY),
    ]
)


@pytest.mark.parametrize("path", sorted(RECIPES.glob("generate/*.yaml")), ids=str)
def test_a_generation_recipe_is_read(path: Path) -> None:
    assert load_recipe(path).split == "train"


@pytest.mark.parametrize("path", TRAINING, ids=str)
def test_a_training_recipe_is_read(path: Path) -> None:
    register_third_party_plugins()
    config = draccus.parse(TrainPipelineConfig, config_path=path, args=["--policy.device=cpu"])
    assert config.policy is not None
    assert config.policy.push_to_hub is False
    assert get_policy_class(config.policy.type).name == config.policy.type


def test_a_study_changes_options_that_exist() -> None:
    register_third_party_plugins()
    study = yaml.safe_load(STUDY.read_text())
    names = [variant["name"] for variant in study["variants"]]
    assert len(set(names)) == len(names)
    for variant in study["variants"]:
        row = {**study["defaults"], **variant}
        options = {**study["common"], **row.get("options", {}), "policy.device": "cpu"}
        words = [f"--{key}={value}" for key, value in options.items()]
        config = draccus.parse(TrainPipelineConfig, config_path=RECIPES.parent / row["config"], args=words)
        for key, value in options.items():
            owner, _, name = key.rpartition(".")
            assert getattr(getattr(config, owner) if owner else config, name) == value, variant["name"]
