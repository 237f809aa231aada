"""A tiny run of `dynahoi dagger`: it logs, leaves a LeRobot checkpoint, and goes on where it was stopped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
import yaml
from lerobot_policy_tracker import TrackerPolicy
from lerobot_policy_tracker.backbones.eye import EyeBackbone
from safetensors.torch import load_file, save_file

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.onpolicy import dagger
from dynahoi_lerobot.onpolicy.run_folder import LOG
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

RECIPES = Path(__file__).parents[2] / "recipes" / "train"
TINY_EYE = {"channels": 8, "fovea": 12, "embedding": 4}


def tiny_recipe(folder: Path, name: str = "standard", **changes: object) -> Path:
    """Write a recipe for the standard class, made tiny, with eyes that have learned nothing."""
    recipe = yaml.safe_load((RECIPES / f"{name}.yaml").read_text())
    torch.manual_seed(0)
    save_file(EyeBackbone(16, **TINY_EYE).learned_state(), folder / "eye.safetensors")
    recipe["episodes"] |= {"image_size": 32, "motions": ["lob"]}
    recipe |= {"rounds": 3, "worlds": 2, "n_episodes": 4, "updates": 2, "batch_episodes": 2, "save_every": 1}
    recipe |= {"validate_every": 2, "validation_episodes": 2}
    policy = recipe["policy"]
    policy |= {"width": 16, "n_attention_heads": 2, "n_obs_frames": 3, "n_window_frames": 2, "image_size": 32}
    eye = TINY_EYE | {"weights": str(folder / "eye.safetensors")}
    policy["backbone_options"] = {"ego": eye, "side": dict(eye)} if policy["backbone"] == "two_eyes" else eye
    for key, feature in policy["input_features"].items():
        feature["shape"] = [3, 32, 32] if "images" in key else feature["shape"]
    path = folder / "recipe.yaml"
    path.write_text(yaml.safe_dump(recipe | changes))
    return path


def run(recipe: Path, out: Path) -> list[dict]:
    assert main(["dagger", "--recipe", str(recipe), "--out", str(out)]) == 0
    return [json.loads(line) for line in (out / LOG).read_text().splitlines()]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dagger")
    run(tiny_recipe(folder), folder / "out")
    return folder / "out"


def test_the_log_tells_scores_against_processor_minutes(finished: Path):
    lines = [json.loads(line) for line in (finished / LOG).read_text().splitlines()]
    assert [line["round"] for line in lines] == [1, 2, 3]
    minutes = [line["processor_minutes"] for line in lines]
    assert minutes == sorted(minutes)
    assert minutes[0] > 0
    assert lines[0]["train"]["S_loc"] is None, "the teacher led all episodes of the first round"
    assert ["val" in line for line in lines] == [False, True, True]
    assert set(lines[1]["val"]) == set(dagger.SCORES)


def test_the_checkpoint_acts_as_any_lerobot_policy_does(finished: Path):
    checkpoint = finished / dagger.CHECKPOINT
    files = {"config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json"}
    files |= {"train_config.json"}
    assert files <= {path.name for path in checkpoint.iterdir()}
    policy = TrackerPolicy.from_pretrained(checkpoint)
    stored = load_file(checkpoint / "model.safetensors")
    assert set(stored) == set(policy.state_dict())
    assert_acts(checkpoint)


def assert_acts(checkpoint: Path, *views: str) -> None:
    agent, recipe = PolicyAgent(str(checkpoint)), Recipe(split="val", image_size=32, views=views)
    assert agent.views == views
    (episode,) = evaluate(WorldBatch(recipe, 1, threads=1), agent, sample_specs(recipe, [0]))
    assert len(episode) > episode.meta.window_frames


@pytest.mark.slow
def test_a_policy_with_a_second_camera_learns_and_acts(tmp_path: Path):
    recipe = tiny_recipe(tmp_path, "two_views", rounds=1)
    (line,) = run(recipe, tmp_path / "out")
    assert line["loss"] > 0
    assert_acts(tmp_path / "out" / dagger.CHECKPOINT, "side")


@pytest.mark.slow
def test_a_run_that_was_stopped_ends_as_one_that_was_not(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    recipe = tiny_recipe(tmp_path)
    played, calls = dagger.play_round, []

    def stopped_in_the_third_round(*args, **kwargs):
        calls.append(args)
        if len(calls) == 4:  # two rounds, a validation
            raise KeyboardInterrupt
        return played(*args, **kwargs)

    monkeypatch.setattr(dagger, "play_round", stopped_in_the_third_round)
    out = tmp_path / "out"
    assert main(["dagger", "--recipe", str(recipe), "--out", str(out)]) == 130
    assert len((out / LOG).read_text().splitlines()) == 2
    monkeypatch.setattr(dagger, "play_round", played)
    lines = run(recipe, out)
    assert [line["round"] for line in lines] == [1, 2, 3]
    weights, expected = (load_file(f / dagger.CHECKPOINT / "model.safetensors") for f in (out, finished))
    for name, tensor in expected.items():
        torch.testing.assert_close(weights[name], tensor, rtol=0, atol=0, msg=name)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"rounds": 0}, "rounds must be 1 or more, got 0"),
        ({"n_episodes": 1}, "n_episodes must be at least worlds, 2, got 1"),
        ({"threads": -1}, "threads must be 0 or more, got -1"),
        ({"teacher_share": 1.5}, "teacher_share must be 0 to 1, got 1.5"),
        ({"episodes": {"split": "test"}}, "episodes.split must be train, got test"),
        ({"policy": {"type": "act"}}, "policy.type must name a policy with a learner, such as tracker, got 'act'"),
        ({"nonsense": 1}, "nonsense"),
    ],
)
def test_a_wrong_recipe_is_refused_in_a_sentence(
    change: dict, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    assert main(["dagger", "--recipe", str(tiny_recipe(tmp_path, **change)), "--out", str(out)]) == 2
    assert told in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("timing", [{"latency_ms": 150.0}, {"latency_ms": [0.0, 370.0], "corrected": True}])
def test_a_student_learns_with_inferences_that_take_time(tmp_path: Path, timing: dict):
    recipe = tiny_recipe(tmp_path, inference={"mode": "async", **timing}, rounds=2, teacher_share=0.0)
    lines = run(recipe, tmp_path / "out")
    assert lines[1]["train"]["S_loc"] is not None
    assert lines[1]["loss"] > 0


@pytest.mark.parametrize(
    ("timing", "told"),
    [
        ({"mode": "rtc"}, "inference.mode must be sync or async, got rtc"),
        ({"mode": "async", "latency_ms": [200, 100]}, "inference.latency_ms must rise, got 200 to 100"),
        ({"latency_ms": 150}, "with mode sync the world waits"),
        ({"corrected": True}, "with mode sync the world waits"),
    ],
)
def test_a_timing_that_cannot_be_learned_with_is_refused(
    timing: dict, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["dagger", "--recipe", str(tiny_recipe(tmp_path, inference=timing))]) == 2
    assert told in capsys.readouterr().err
