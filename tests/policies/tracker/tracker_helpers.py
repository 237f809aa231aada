"""Small datasets, in the layout of the design and in a stock one, and policies made for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot_policy_tracker import TrackerConfig, TrackerPolicy

N_EPISODES, N_FRAMES, FPS, SIZE = 2, 40, 20, 64

TINY = {
    "width": 16,
    "n_attention_heads": 2,
    "image_size": 32,
    "n_obs_frames": 2,
    "horizon": 8,
    "n_action_steps": 4,
    "backbone_options": {"n_keypoints": 4, "channels": 8},
    "head_options": {"n_layers": 1},
    "device": "cpu",
    "push_to_hub": False,
}

HAND_FEATURES = {
    "observation.images.ego": {
        "dtype": "image",
        "shape": (SIZE, SIZE, 3),
        "names": ["height", "width", "channel"],
    },
    "observation.state": {"dtype": "float32", "shape": (18,), "names": None},
    "observation.fingertips": {"dtype": "float32", "shape": (30,), "names": None},
    "observation.phase": {"dtype": "float32", "shape": (2,), "names": ["observing", "acting"]},
    "action": {"dtype": "float32", "shape": (18,), "names": None},
}

PUSH_FEATURES = {
    "observation.image": {
        "dtype": "image",
        "shape": (SIZE, SIZE, 3),
        "names": ["height", "width", "channel"],
    },
    "observation.state": {"dtype": "float32", "shape": (2,), "names": None},
    "action": {"dtype": "float32", "shape": (2,), "names": None},
}


def write_dataset(root: Path, features: dict, seed: int = 0) -> LeRobotDataset:
    """Write episodes in which every vector is a smooth walk and the action is the next state."""
    rng = np.random.default_rng(seed)
    dataset = LeRobotDataset.create("local/tiny", fps=FPS, features=features, root=root, use_videos=False)
    vectors = [key for key, feature in features.items() if feature["dtype"] == "float32" and key != "action"]
    images = [key for key, feature in features.items() if feature["dtype"] == "image"]
    for _ in range(N_EPISODES):
        walks = {key: rng.normal(size=(N_FRAMES + 1, *features[key]["shape"])).cumsum(0) for key in vectors}
        if "observation.phase" in walks:
            walks["observation.phase"] = np.eye(2)[(np.arange(N_FRAMES + 1) >= 8).astype(int)]
        for t in range(N_FRAMES):
            frame = {key: walk[t].astype(np.float32) for key, walk in walks.items()}
            frame |= {key: rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8) for key in images}
            frame["action"] = walks["observation.state"][t + 1].astype(np.float32)
            dataset.add_frame({**frame, "task": "catch the ball"})
        dataset.save_episode()
    dataset.finalize()
    return dataset


def stats_of(x: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return LeRobot's statistics of ``(n, D)`` values."""
    quantiles = {f"q{q:02d}": torch.quantile(x, q / 100, dim=0) for q in (1, 10, 90, 99)}
    return {"mean": x.mean(0), "std": x.std(0), "min": x.amin(0), "max": x.amax(0)} | quantiles


def policy_features(features: dict) -> tuple[dict[str, PolicyFeature], dict[str, PolicyFeature]]:
    inputs, outputs = {}, {}
    for key, feature in features.items():
        shape = tuple(feature["shape"])
        if feature["dtype"] == "image":
            inputs[key] = PolicyFeature(FeatureType.VISUAL, (shape[2], shape[0], shape[1]))
        elif key == "action":
            outputs[key] = PolicyFeature(FeatureType.ACTION, shape)
        else:
            inputs[key] = PolicyFeature(FeatureType.STATE, shape)
    return inputs, outputs


def make_policy(
    features: dict = HAND_FEATURES, stats: dict | None = None, meta: object = None, **changes: object
) -> TrackerPolicy:
    inputs, outputs = policy_features(features)
    torch.manual_seed(0)
    config = TrackerConfig(input_features=inputs, output_features=outputs, **{**TINY, **changes})
    return TrackerPolicy(config, dataset_stats=stats, dataset_meta=meta)


def phase_of(acting: torch.Tensor) -> torch.Tensor:
    """Return the phase (..., 2) of frames that are acting as far as (...) says, 0 to 1."""
    return torch.stack([1 - acting, acting], dim=-1)


def make_batch(policy: TrackerPolicy, n: int = 3, seed: int = 0) -> dict[str, object]:
    """Draw a training batch as LeRobot's loader would deliver it after preprocessing."""
    generator, config = torch.Generator().manual_seed(seed), policy.config
    n_frames, n_actions = len(config.observation_delta_indices), len(config.action_delta_indices)
    batch: dict[str, object] = {}
    for key, feature in config.input_features.items():
        draw = torch.rand if feature.type is FeatureType.VISUAL else torch.randn
        batch[key] = draw(n, n_frames, *feature.shape, generator=generator)
        batch[f"{key}_is_pad"] = torch.zeros(n, n_frames, dtype=torch.bool)
    if "observation.phase" in batch:  # the hand may move: chunks planned before it may are not learned from
        batch["observation.phase"] = phase_of(torch.ones(n, n_frames))
    batch["action"] = torch.randn(n, n_actions, *config.action_feature.shape, generator=generator)
    batch["action_is_pad"] = torch.zeros(n, n_actions, dtype=torch.bool)
    batch["task"] = ["catch the ball"] * n
    return batch


def make_step(policy: TrackerPolicy, n: int = 3, seed: int = 0, phase: float | list[float] = 0.0) -> dict[str, object]:
    """Draw one environment step as `lerobot-eval` would deliver it after preprocessing."""
    generator = torch.Generator().manual_seed(seed)
    step: dict[str, object] = {"task": ["catch the ball"] * n}
    for key, feature in policy.config.input_features.items():
        draw = torch.rand if feature.type is FeatureType.VISUAL else torch.randn
        step[key] = draw(n, *feature.shape, generator=generator)
    if "observation.phase" in step:
        step["observation.phase"] = phase_of(torch.tensor([phase] * n if isinstance(phase, float) else phase))
    return step


def randomise(policy: TrackerPolicy, seed: int = 1) -> TrackerPolicy:
    """Give every weight a random value, so that nothing is hidden behind a zero."""
    generator = torch.Generator().manual_seed(seed)
    for name, parameter in policy.named_parameters():
        fan_in = parameter[0].numel() if parameter.dim() > 1 else 4
        parameter.data = 2 * torch.randn(parameter.shape, generator=generator) / fan_in**0.5
        if "norm" in name:
            parameter.data += 1
    return policy


def mean_loss(policy: TrackerPolicy, batch: dict[str, object], n_draws: int = 20) -> float:
    """Return the loss of a batch, averaged over the same noise at every call."""
    torch.manual_seed(0)
    with torch.no_grad():
        return sum(policy.eval()(batch)[0].item() for _ in range(n_draws)) / n_draws


def fit(policy: TrackerPolicy, batch: dict[str, object], n_steps: int, lr: float) -> None:
    """Train on one batch."""
    torch.manual_seed(1)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=lr)
    for _ in range(n_steps):
        policy.train()(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
