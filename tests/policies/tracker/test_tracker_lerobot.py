"""Through LeRobot's own commands and functions: train, resume, open, fine-tune, evaluate, share."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import torch
from accelerate.state import AcceleratorState
from huggingface_hub import ModelCard
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata, StreamingLeRobotDataset
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.policies import make_policy as open_lerobot_policy
from lerobot.policies import make_pre_post_processors
from lerobot.scripts.lerobot_eval import eval_policy
from lerobot.scripts.lerobot_train import main
from lerobot_policy_tracker import TrackerPolicy
from safetensors.torch import load_file
from torch.utils.data import DataLoader
from tracker_helpers import FPS, HAND_FEATURES, SIZE, TINY, make_policy, make_step, write_dataset

STEP_2, STEP_4 = "checkpoints/000002/pretrained_model", "checkpoints/000004/pretrained_model"


def lerobot_train(monkeypatch: pytest.MonkeyPatch, *args: str) -> None:
    AcceleratorState._reset_state(reset_partial_state=True)  # each command is a process of its own otherwise
    monkeypatch.setattr(sys, "argv", ["lerobot-train", *args])
    main()


def flags(**values: object) -> list[str]:
    plain = (str, Path)
    return [f"--{key}={value if isinstance(value, plain) else json.dumps(value)}" for key, value in values.items()]


def fresh_run(root: Path, out: Path, **changes: object) -> list[str]:
    run = {"dataset.repo_id": "local/tiny", "dataset.root": root, "output_dir": out, "seed": 1}
    run |= {"batch_size": 4, "steps": 4, "save_freq": 2, "num_workers": 0, "env_eval_freq": 0, "log_freq": 1}
    policy = {f"policy.{key}": value for key, value in TINY.items()}
    return flags(**{"policy.type": "tracker", **policy, **run, **changes})


@pytest.fixture(scope="module")
def trained(hand_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of four steps with checkpoints at two and four."""
    out = tmp_path_factory.mktemp("run") / "out"
    with pytest.MonkeyPatch.context() as monkeypatch:
        lerobot_train(monkeypatch, *fresh_run(hand_root, out))
    return out


def open_policy(checkpoint: Path, root: Path):
    """Open a checkpoint with its processors, the way LeRobot's commands do."""
    config = PreTrainedConfig.from_pretrained(checkpoint)
    config.pretrained_path = checkpoint
    policy = open_lerobot_policy(config, ds_meta=LeRobotDataset("local/tiny", root=root).meta)
    return policy.eval(), *make_pre_post_processors(config, pretrained_path=str(checkpoint))


def test_a_checkpoint_opens_and_acts_the_same_after_another_save(
    trained: Path, hand_root: Path, tmp_path: Path
) -> None:
    policy, preprocess, postprocess = open_policy(trained / STEP_4, hand_root)
    assert policy.config.fps == FPS
    assert policy.config.action_frame == "relative"  # the data's action is the next state
    step = preprocess(make_step(policy))
    action = postprocess(policy.select_action(step))
    assert action.shape == (3, 18)
    policy.save_pretrained(tmp_path)
    again = TrackerPolicy.from_pretrained(tmp_path)
    torch.testing.assert_close(postprocess(again.select_action(step)), action, rtol=0, atol=0)


def test_resuming_continues_where_the_run_stopped(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(trained / "checkpoints/000002", tmp_path / "checkpoints/000002")
    config = tmp_path / STEP_2 / "train_config.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | {"output_dir": str(tmp_path)}))
    lerobot_train(monkeypatch, f"--config_path={config}", "--resume=true")
    whole, resumed = (load_file(root / STEP_4 / "model.safetensors") for root in (trained, tmp_path))
    start = load_file(trained / STEP_2 / "model.safetensors")
    # LeRobot restores the order of the data but not every draw of noise, so the weights agree only roughly.
    assert whole.keys() == resumed.keys()
    assert resumed["ema.n_averaged"] == whole["ema.n_averaged"] == 4
    assert resumed["frame.n_batches"] == whole["frame.n_batches"] == 4
    torch.testing.assert_close(resumed["frame.mean_square"], whole["frame.mean_square"])
    trained_keys = [key for key in whole if key.startswith("model.")]
    change, gap = (
        sum((x[key] - y[key]).square().sum() for key in trained_keys) for x, y in ((whole, start), (whole, resumed))
    )
    assert 0 < gap < 0.5 * change


def test_history_is_learned_from_a_stream(hand_root: Path) -> None:
    meta = LeRobotDatasetMetadata("local/tiny", root=hand_root)
    policy = make_policy(memory="both", stats=meta.stats).train()
    preprocess, _ = make_pre_post_processors(policy.config, dataset_stats=meta.stats)
    window = resolve_delta_timestamps(policy.config, meta)
    assert len(window["observation.phase"]) > policy.config.n_obs_frames
    frames = StreamingLeRobotDataset("local/tiny", root=hand_root, delta_timestamps=window)
    batch = preprocess(next(iter(DataLoader(frames, batch_size=16))))
    assert batch["observation.phase"].shape == (16, len(window["observation.phase"]), 2)
    policy(batch)[0].backward()
    learned = [p.grad for p in policy.model.head.parameters()]
    assert all(grad is not None and grad.isfinite().all() for grad in learned)
    assert any(grad.any() for grad in learned), "of 16 shuffled frames none is after the window"


def test_fine_tuning_takes_the_units_of_the_new_data(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "data"
    write_dataset(root, HAND_FEATURES, seed=7)
    args = {"policy.path": trained / STEP_4, "dataset.repo_id": "local/tiny", "dataset.root": root}
    args |= {"output_dir": tmp_path / "out", "steps": 2, "batch_size": 2, "num_workers": 0, "policy.push_to_hub": False}
    lerobot_train(monkeypatch, *flags(**args))
    state = load_file(tmp_path / "out" / STEP_2 / "model.safetensors")
    expected = torch.as_tensor(LeRobotDataset("local/tiny", root=root).meta.stats["action"]["std"][:3]).float()
    torch.testing.assert_close(state["frame.action_scale"], expected)
    before = load_file(trained / STEP_4 / "model.safetensors")
    assert (state["frame.action_scale"] - before["frame.action_scale"]).abs().max() > 1e-3


def test_several_decisions_and_mixed_precision_train(
    hand_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = {"policy.n_decisions": 3, "policy.use_amp": True, "policy.head": "diffusion", "steps": 2}
    lerobot_train(monkeypatch, *fresh_run(hand_root, tmp_path / "out", **changes))
    state = load_file(tmp_path / "out" / STEP_2 / "model.safetensors")
    assert all(value.isfinite().all() for value in state.values())
    assert state["model.proprioception.0.weight"].dtype == torch.float32


def test_a_stock_layout_trains(push_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lerobot_train(monkeypatch, *fresh_run(push_root, tmp_path / "out", steps=2))
    policy, preprocess, postprocess = open_policy(tmp_path / "out" / STEP_2, push_root)
    assert postprocess(policy.select_action(preprocess(make_step(policy)))).shape == (3, 2)


class ToyEnv(gym.Env):
    """An environment in LeRobot's stock layout that records what it is told."""

    metadata: ClassVar[dict] = {"render_fps": FPS, "render_modes": ["rgb_array"]}
    task_description = task = "push"
    _max_episode_steps = 6

    def __init__(self) -> None:
        pixels = gym.spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        vector = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.observation_space = gym.spaces.Dict({"pixels": pixels, "agent_pos": vector})
        self.action_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        super().reset(seed=seed)
        self.t, self.position = 0, self.np_random.normal(size=2).astype(np.float32)
        return self._observation(), {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        self.t, self.position = self.t + 1, np.asarray(action, np.float32)
        reward = float(np.isfinite(action).all())
        return self._observation(), reward, False, self.t >= self._max_episode_steps, {"is_success": False}

    def render(self) -> np.ndarray:
        return np.zeros((SIZE, SIZE, 3), np.uint8)

    def _observation(self) -> dict[str, np.ndarray]:
        pixels = np.full((SIZE, SIZE, 3), 20 * self.t, np.uint8)
        return {"pixels": pixels, "agent_pos": self.position}


def test_lerobots_evaluation_runs_and_repeats(push_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.processor import PolicyProcessorPipeline

    lerobot_train(monkeypatch, *fresh_run(push_root, tmp_path / "out", steps=2, **{"policy.n_action_steps": 2}))
    policy, preprocess, postprocess = open_policy(tmp_path / "out" / STEP_2, push_root)
    env = gym.vector.SyncVectorEnv([ToyEnv, ToyEnv], autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP)
    identity = PolicyProcessorPipeline(steps=[])
    actions: list[torch.Tensor] = []
    select = policy.select_action
    policy.select_action = lambda batch: actions.append(select(batch)) or actions[-1]
    for _ in range(2):
        info = eval_policy(env, policy, identity, identity, preprocess, postprocess, n_episodes=2, start_seed=3)
        assert info["aggregated"]["avg_sum_reward"] == ToyEnv._max_episode_steps
    half = len(actions) // 2
    torch.testing.assert_close(torch.stack(actions[:half]), torch.stack(actions[half:]), rtol=0, atol=0)


def test_adapters_train_and_open(
    trained: Path, hand_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    args = {"policy.path": trained / STEP_4, "dataset.repo_id": "local/tiny", "dataset.root": hand_root}
    args |= {"output_dir": tmp_path / "out", "steps": 2, "batch_size": 2, "num_workers": 0, "policy.push_to_hub": False}
    lerobot_train(monkeypatch, *flags(**args, **{"peft.method_type": "LORA", "peft.r": 4}))
    checkpoint = tmp_path / "out" / STEP_2
    adapters = load_file(checkpoint / "adapter_model.safetensors")
    assert all("lora" in key and ("q_proj" in key or "v_proj" in key) for key in adapters)
    assert any(value.abs().max() > 0 for key, value in adapters.items() if "lora_B" in key)
    policy, preprocess, _ = open_policy(checkpoint, hand_root)
    assert policy.config.use_peft
    assert policy.select_action(preprocess(make_step(policy))).isfinite().all()


def test_the_model_card_says_what_the_policy_is(
    trained: Path, hand_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ModelCard, "validate", lambda self: None)  # asks the hub
    policy, _, _ = open_policy(trained / STEP_4, hand_root)
    card = policy.generate_model_card("me/catches", "tracker", "apache-2.0", ["catching"])
    assert card.data.datasets == "me/catches"
    for fact in ("Observed frames (s) | 2, 0.1 s apart", "`flow`, 8 actions (0.4 s)", "relative to the current state"):
        assert fact in card.text
    assert "Training dataset | `me/catches`" in card.text
    assert "--env.type=dynahoi" in card.text
    assert "| `observation.state` | STATE |" in card.text  # LeRobot's own sections stay
    for absent in ("<", "{", "robot.type", "robot.port", "pip install"):
        assert absent not in card.text.split("## Tracker")[1].split("## Citation")[0]
    assert "lerobot-rollout" not in card.text
    assert "@misc{cadene2024lerobot" in card.text
