"""Every recipe is one that LeRobot, or our generator, reads as it stands."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import draccus
import pytest
import yaml
from lerobot.configs import PreTrainedConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.factory import make_dataset
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_policy_obact.encoders import SHIPPED
from torch.utils.data import default_collate

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.control_class import control_class_of
from dynahoi_lerobot.evaluate import command as evaluate_command
from dynahoi_lerobot.foundation.conventions import EGO_VIEW
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, EyeRecipe, read_recipe
from dynahoi_lerobot.sampling.recipe import load_recipe

RECIPES = Path(__file__).parents[3] / "recipes"
STUDIES = sorted(path for path in RECIPES.glob("study/*.yaml") if "variants" in yaml.safe_load(path.read_text()))
ON_POLICY = {path for path in RECIPES.glob("train/*.yaml") if "rounds" in yaml.safe_load(path.read_text())}
EYES = {path for path in RECIPES.glob("train/*.yaml") if "pictures" in yaml.safe_load(path.read_text())}
TRAINING = sorted(
    [
        *(path for path in RECIPES.glob("train/*.yaml") if path not in EYES | ON_POLICY),
        *RECIPES.glob("zoo/*.yaml"),
        *(path for path in RECIPES.glob("study/*.yaml") if path not in STUDIES),
    ]
)


def _script(path: Path) -> Any:
    """Import a script that no package holds."""
    spec = importlib.util.spec_from_file_location(f"recipe_{path.stem}", path)
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


STUDY = _script(RECIPES / "study" / "run.py")


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


@pytest.mark.parametrize("path", sorted(EYES), ids=str)
def test_an_eyes_recipe_is_read_and_an_eye_of_its_size_ships(path: Path) -> None:
    recipe = read_recipe(EyeRecipe, path)
    camera = "" if recipe.camera == EGO_VIEW else f"{recipe.camera}_"
    assert SHIPPED[f"shipped_{camera}{recipe.episodes.image_size}"].is_file()


@pytest.mark.parametrize("path", sorted(ON_POLICY), ids=str)
def test_a_recipe_in_memory_is_read_and_its_policy_keeps_to_the_control_class(path: Path) -> None:
    recipe = read_recipe(DaggerRecipe, path)
    config = draccus.decode(PreTrainedConfig, recipe.policy | {"backbone_options": {}})
    control = control_class_of(recipe.episodes.control_class)
    assert config.latency_frames == control.latency_frames
    fastest = CAPTURES[recipe.episodes.capture].palm_speed_m_s(control)
    assert config.head_options["palm_speed_m_s"] <= fastest
    assert recipe.episodes.capture == "contact" or config.head_options["palm_speed_m_s"] == fastest
    options, size = recipe.policy["backbone_options"], config.image_size
    two = {"ego": {"weights": f"shipped_{size}"}, "side": {"weights": f"shipped_side_{size}"}}
    assert options == (two if recipe.episodes.views else {"weights": f"shipped_{size}"})
    assert recipe.episodes.image_size == size
    base = "two_views" if recipe.episodes.views else "standard"
    standard = yaml.safe_load((RECIPES / "train" / f"{base}.yaml").read_text())["policy"]
    changed = {key for key in standard if recipe.policy.get(key) != standard[key]}
    assert changed <= {"repo_id", "head_options", "device"}, "the classes share their weights"


@pytest.mark.slow
@pytest.mark.parametrize(("name", "learned"), [("tracker_cpu", "backbone.slot"), ("demonstrations", "head.out.weight")])
def test_the_cpu_recipes_learn_from_what_is_generated(name: str, learned: str, tmp_path: Path) -> None:
    register_third_party_plugins()
    root = STUDY.generate({"recipe": "recipes/generate/train_small.yaml", "episodes": 2}, tmp_path)
    config = draccus.parse(TrainPipelineConfig, RECIPES / f"train/{name}.yaml", args=[f"--dataset.root={root}"])
    dataset = make_dataset(config)

    policy = make_policy(config.policy, ds_meta=dataset.meta)
    preprocess, _ = make_pre_post_processors(config.policy, dataset_stats=dataset.meta.stats)
    batch = default_collate([dataset[0], dataset[len(dataset) // 2]])
    camera = "observation.images.ego"
    loss, _ = policy(preprocess(batch | {camera: batch[camera] / 255.0}))
    loss.backward()
    assert policy.model.get_parameter(learned).grad.abs().max() > 0


def _lerobot_train(row: dict[str, Any], options: dict[str, Any]) -> TrainPipelineConfig:
    return draccus.parse(TrainPipelineConfig, config_path=RECIPES.parent / row["config"], args=STUDY.words(options))


def _dagger(row: dict[str, Any], options: dict[str, Any]) -> DaggerRecipe:
    """Return the recipe with its policy's config in place of the fields of one."""
    values = STUDY.changed(yaml.safe_load((RECIPES.parent / row["config"]).read_text()), options)
    recipe = draccus.decode(DaggerRecipe, values)
    return replace(recipe, policy=draccus.decode(PreTrainedConfig, values["policy"] | {"backbone_options": {}}))


@pytest.mark.parametrize("path", STUDIES, ids=str)
def test_a_study_evaluates_under_conditions_that_exist(path: Path) -> None:
    study = yaml.safe_load(path.read_text())
    named = {name for row in study["variants"] for name in {**study["defaults"], **row}.get("conditions", [])}
    assert named == set(study.get("conditions", {}))
    for how in study.get("conditions", {}).values():
        parser = argparse.ArgumentParser()
        evaluate_command.add_arguments(parser)
        assert parser.parse_args(["--policy=hold", *STUDY.repeated(how)]).policy == "hold"


@pytest.mark.slow
@pytest.mark.parametrize("path", STUDIES, ids=str)
def test_a_study_changes_options_that_exist(path: Path) -> None:
    register_third_party_plugins()
    study = yaml.safe_load(path.read_text())
    names = [variant["name"] for variant in study["variants"]]
    assert len(set(names)) == len(names)
    for variant in study["variants"]:
        row = {**study["defaults"], **variant}
        assert row.get("as_long_as", "") in ("", *names[: names.index(row["name"])]), "its time must be known by then"
        options = {**study["common"], **row.get("options", {}), "policy.device": "cpu"}
        config = _dagger(row, options) if row.get("trainer") == "dagger" else _lerobot_train(row, options)
        for key, value in options.items():
            owner, _, name = key.rpartition(".")
            found = draccus.encode(getattr(getattr(config, owner) if owner else config, name))
            assert found == value, variant["name"]


@pytest.mark.parametrize("path", STUDIES, ids=str)
def test_every_variant_of_a_study_can_be_trained_with_other_seeds(path: Path) -> None:
    study = yaml.safe_load(path.read_text())
    variants = [STUDY.Variant(**{**study["defaults"], **row}) for row in study["variants"]]
    seeded = [STUDY.seeded(variant, seed) for seed in (3, 4) for variant in variants]
    names = [variant.name for variant in seeded]
    assert len(set(names)) == 2 * len(variants)
    for place, variant in enumerate(seeded):
        seed = 3 + place // len(variants)
        assert variant.options == {**variants[place % len(variants)].options, "seed": seed}
        assert variant.extra["training_seed"] == seed
        assert variant.as_long_as in ("", *names[:place]), "its time must be known by then"


@pytest.mark.parametrize(("times", "steps"), [(1, 1000), (10, 10630)])
def test_a_variant_gets_as_many_steps_as_fit_in_the_time_of_another(
    times: int, steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second per ten steps after 7 s of start-up: 107 s are 1,000 steps, and 1,070 s are 10,630."""
    trained: list[int] = []

    def lerobot_train(variant: Any, options: dict[str, Any], out: Path) -> float:
        trained.append(options["steps"])
        return 7 + options["steps"] / 10

    monkeypatch.setattr(STUDY, "lerobot_train", lerobot_train)
    (tmp_path / "slow").mkdir()
    (tmp_path / "fast").mkdir()
    (tmp_path / "slow" / "seconds.json").write_text("107")
    variant = STUDY.Variant("fast", "any.yaml", as_long_as="slow", times=times)
    STUDY.train(variant, {"steps": 5}, tmp_path / "data", tmp_path / "fast")
    assert trained == [*STUDY.PACE_STEPS, steps]
    assert json.loads((tmp_path / "fast" / "seconds.json").read_text()) == 107 * times
