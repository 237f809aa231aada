"""What was pushed is used by its name on the Hub, by LeRobot and by ``dynahoi evaluate``, from an empty cache."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.evaluate.result_files import METRICS_FILE
from tests.hub.conftest import Push
from tests.hub.server import TOKEN, Hub

CHECKPOINT = Path(__file__).parents[2] / "checkpoints/obact_standard"
READ = """
from datasets import load_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from dynahoi_lerobot.verify.command import verify
dataset = LeRobotDataset("me/catching", video_backend="pyav")
sample = dataset[len(dataset) - 1]
print(dataset.num_episodes, dataset.meta.episodes[0]["motion"], *sample["observation.images.ego"].shape)
print(*verify(dataset.root))
table = load_dataset("me/catching", split="train")
print(len(table) == len(dataset), table.features["action"].length, table.features["action"].feature.dtype)
"""

pytestmark = pytest.mark.slow  # LeRobot takes long to import


def elsewhere(hub: Hub, home: Path, *words: str, token: str = "") -> str:
    """Run Python with an empty cache and, unless one is given, no token; return what it printed."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HF_")}
    environment |= {"HF_ENDPOINT": hub.url, "HF_HOME": str(home), "HF_HUB_DISABLE_XET": "1"}
    environment |= {"HF_TOKEN": token} if token else {}
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_dataset_is_read_by_its_name(simulated: Path, hub: Hub, push: Push, tmp_path: Path):
    push(simulated, "me/catching")
    facts, findings, table = elsewhere(hub, tmp_path / "home", "-c", READ).splitlines()
    seeds = Manifest.read(simulated).seeds
    assert facts.split()[0] == str(len(seeds))
    assert facts.split()[2:] == ["3", "32", "32"]
    assert findings == ""
    assert table.split() == ["True", "18", "float32"]


def test_a_checkpoint_is_evaluated_by_its_name_and_its_results_stand_beside_it(hub: Hub, push: Push, tmp_path: Path):
    checkpoint, results = shutil.copytree(CHECKPOINT, tmp_path / "checkpoint"), tmp_path / "results"
    assert push(checkpoint, "me/obact")[0] == 0
    words = ("-m", "dynahoi_lerobot.cli.main", "evaluate", "--policy", "me/obact", "--episodes", "2", "--out")
    elsewhere(hub, tmp_path / "home", *words, str(results))
    code, out, err = push(results, "me/obact")
    assert code == 0, err
    assert f"results pushed to {hub.url}/me/obact" in out
    files = hub.repos["models/me/obact"].files
    assert set(files) > {path.name for path in checkpoint.iterdir()}
    head = json.loads((results / METRICS_FILE).read_text())
    name = f"v2_{head['split']}_attach_{head['extra']['recipe']['control_class']}_image_size_96_2_episodes"
    assert json.loads(files[f"results/{name}/{METRICS_FILE}"]) == head
    assert push(checkpoint, "me/obact")[0] == 0, "results beside it are no obstacle"


TRAIN = """
from huggingface_hub import RepoCard
from lerobot.scripts.lerobot_train import main
RepoCard.validate = lambda *args, **options: None  # asks huggingface.co, whatever the Hub's address is
main()
"""
TINY = {
    "policy.type": "obact", "policy.dim": 16, "policy.n_heads": 2, "policy.width": 32, "policy.n_obs_frames": 2,
    "policy.encoder_options": '{"channels": 8}', "policy.head_options": '{"width": 16}', "policy.device": "cpu",
    "batch_size": 2, "steps": 2, "num_workers": 0,
    "env_eval_freq": 0, "dataset.repo_id": "me/catching", "policy.push_to_hub": "true", "policy.repo_id": "me/trained",
}  # fmt: skip
PLAYED = {
    "policy.path": "me/trained", "policy.device": "cpu", "env.type": "dynahoi", "env.split": "test_small",
    "env.task": "lob", "env.image_size": 32, "eval.n_episodes": 1, "eval.batch_size": 1,
}  # fmt: skip


def options(out: Path, values: dict) -> list[str]:
    """Return the words of a command of LeRobot that writes to ``out``."""
    return [f"--{name}={value}" for name, value in {**values, "output_dir": out}.items()]


def test_lerobot_trains_on_a_dataset_by_its_name_pushes_the_policy_and_plays_it_by_its_name(
    simulated: Path, hub: Hub, push: Push, tmp_path: Path
):
    push(simulated, "me/catching")
    out = tmp_path / "out"
    elsewhere(hub, tmp_path / "home", "-c", TRAIN, *options(out, TINY), token=TOKEN)
    weights = (out / "checkpoints/last/pretrained_model/model.safetensors").read_bytes()
    files = hub.repos["models/me/trained"].files
    assert files["model.safetensors"] == weights
    assert {"README.md", "config.json", "policy_preprocessor.json", "policy_postprocessor.json"} < set(files)
    words = options(tmp_path / "eval", PLAYED)
    elsewhere(hub, tmp_path / "other_home", "-m", "lerobot.scripts.lerobot_eval", *words)
    (metrics,) = (tmp_path / "eval").rglob(METRICS_FILE)
    assert json.loads(metrics.read_text())["n"] == 1
    code, _, err = push(metrics.parent, "me/trained", "--policy", json.loads(metrics.read_text())["policy"])
    assert code == 0, err
    folders = {name.split("/")[1] for name in hub.repos["models/me/trained"].files if name.startswith("results/")}
    assert [name.startswith("v2_test_small_attach_standard_image_size_32_1_episodes") for name in folders] == [True]
    assert push(out / "checkpoints/last/pretrained_model", "me/trained")[0] == 0


PLAY = """
from lerobot.envs.factory import make_env
suites = make_env("me/dynahoi-env", n_envs=2, trust_remote_code=True)
envs = next(iter(next(iter(suites.values())).values()))
observation, info = envs.reset(seed=[0, 1])
observation, reward, *_ = envs.step(envs.action_space.sample())
print(len(suites), *observation["agent_pos"].shape, *reward.shape)
"""


def test_an_environment_is_made_by_its_name(hub: Hub, push: Push, tmp_path: Path):
    folder = Path(__file__).parents[2] / "envs/hub"
    code, out, err = push(folder, "me/dynahoi-env")
    assert code == 0, err
    assert f"environment pushed to {hub.url}/me/dynahoi-env" in out
    assert set(hub.repos["models/me/dynahoi-env"].files) == {"README.md", "env.py"}
    assert elsewhere(hub, tmp_path / "home", "-c", PLAY).split() == ["8", "2", "18", "2"]
