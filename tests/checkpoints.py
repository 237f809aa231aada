"""Checkpoints for tests: what ships, and tiny policies with random weights; how parts learn."""

import json
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot_policy_obact import ObActConfig, ObActPolicy
from lerobot_policy_obact.windows import Window

SHIPPED = Path(__file__).parents[1] / "checkpoints" / "obact_standard"
SMALL_GR00T = {
    "n_layers": 2,
    "n_heads": 2,
    "head_dim": 8,
    "hidden_dim": 16,
    "memory_dim": 16,
    "n_adapter_layers": 1,
    "n_adapter_heads": 2,
    "n_future_tokens": 3,
    "max_state_dim": 5,
    "max_action_dim": 4,
    "dropout": 0.0,
}
"""Options of ObAct's head gr00t."""
TINY_OBACT = {
    "dim": 16,
    "n_heads": 2,
    "width": 32,
    "n_points": 4,
    "head_options": {"width": 16},
    "encoder": "conv",
    "encoder_options": {"channels": 8},
    "freeze_encoder": False,
}
FEATURES = {
    "input_features": {
        "observation.images.ego": PolicyFeature(FeatureType.VISUAL, (3, 32, 32)),
        "observation.state": PolicyFeature(FeatureType.STATE, (18,)),
    },
    "output_features": {"action": PolicyFeature(FeatureType.ACTION, (18,))},
    "normalization_mapping": dict.fromkeys(
        ("VISUAL", "ENV", "STATE", "ACTION"), NormalizationMode.IDENTITY
    ),
    "device": "cpu",
    "push_to_hub": False,
}


def window_of(policy: ObActPolicy, batch: dict[str, torch.Tensor]) -> Window:
    """The windows that a policy learns from, while inference takes no time."""
    return Window.of(batch, policy.model, policy.targets)


def observation(config: PreTrainedConfig, n: int = 1, seed: int = 0) -> dict[str, torch.Tensor]:
    """Random images and states of ``n`` environments."""
    generator = torch.Generator().manual_seed(seed)
    inputs = config.input_features
    return {key: torch.rand(n, *inputs[key].shape, generator=generator) for key in inputs}


def fit(
    parameters: Iterable[torch.Tensor],
    loss: Callable[[], torch.Tensor],
    steps: int,
    rate: float = 3e-3,
) -> list[float]:
    """Minimize a loss by Adam; return what it was in each step."""
    optimizer = torch.optim.Adam(parameters, lr=rate)
    losses = []
    for _ in range(steps):
        optimizer.zero_grad()
        now = loss()
        now.backward()
        optimizer.step()
        losses.append(now.item())
    return losses


def saved(
    config: PreTrainedConfig, folder: Path, stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> Path:
    """Write a checkpoint with random weights, none of them zero, and statistics of its
    normalizers.
    """
    torch.manual_seed(0)
    policy = get_policy_class(config.type)(config)
    for weight in policy.parameters():
        weight.data += 0.05 * torch.randn_like(weight)
    policy.save_pretrained(folder)
    for pipeline in make_pre_post_processors(config, dataset_stats=stats):
        pipeline.save_pretrained(folder)
    return folder


def tiny_act(folder: Path, inputs: dict[str, PolicyFeature]) -> Path:
    """Write an ACT that executes chunks of eight."""
    small = {
        "dim_model": 32,
        "n_heads": 2,
        "dim_feedforward": 32,
        "n_encoder_layers": 1,
        "n_decoder_layers": 1,
    }
    small |= {
        "chunk_size": 8,
        "n_action_steps": 8,
        "use_vae": False,
        "pretrained_backbone_weights": None,
    }
    return saved(ACTConfig(**small, **FEATURES | {"input_features": inputs}), folder)


def tiny_diffusion(folder: Path) -> Path:
    """Write a Diffusion Policy that sees the target's true state and no image."""
    small = {
        "down_dims": (16, 32),
        "n_groups": 4,
        "horizon": 8,
        "n_action_steps": 4,
        "n_obs_steps": 2,
    }
    small |= {"noise_scheduler_type": "DDIM", "num_inference_steps": 2}
    inputs = {
        name: PolicyFeature(type_, (size,))
        for name, type_, size in (
            ("observation.state", FeatureType.STATE, 18),
            ("observation.environment_state", FeatureType.ENV, 13),
        )
    }
    return saved(DiffusionConfig(**small, **FEATURES | {"input_features": inputs}), folder)


def tiny_obact(folder: Path) -> Path:
    """Write an ObAct for images of 32 pixels, which sees six frames and executes half of its chunks
    of eight.
    """
    small = TINY_OBACT | {"horizon": 8, "n_obs_steps": 6, "n_action_steps": 4}
    return saved(ObActConfig(**small, **FEATURES), folder)


def tiny_adapter(base: Path, folder: Path, named: str | None = None) -> Path:
    """Write a LoRA adapter with random weights for the checkpoint ``base``, which it calls
    ``named``.
    """
    config = PreTrainedConfig.from_pretrained(str(base))
    config.pretrained_path = Path(named or base)
    policy = get_policy_class(config.type).from_pretrained(str(base), config=config)
    adapted = policy.wrap_with_peft(peft_cli_overrides={"method_type": "LORA", "r": 2})
    torch.manual_seed(0)
    for name, weight in adapted.named_parameters():
        if "lora_" in name:
            weight.data = 0.1 * torch.randn_like(weight)
    adapted.save_pretrained(str(folder))
    adapted.config.save_pretrained(folder)
    for file in base.glob("policy_*"):
        shutil.copy(file, folder)
    return folder


RENAMES = {
    f"observation.images.{view}": f"observation.images.camera{number}"
    for number, view in enumerate(("ego", "side"), start=1)
}
"""The rename map of ``renamed_act``."""


def renamed_act(folder: Path) -> Path:
    """Write an ACT that knows the cameras by other names, as LeRobot's ``--rename_map`` trains."""
    camera = PolicyFeature(FeatureType.VISUAL, (3, 32, 32))
    inputs = dict.fromkeys(RENAMES.values(), camera)
    tiny_act(
        folder, inputs | {"observation.state": FEATURES["input_features"]["observation.state"]}
    )
    file = folder / "policy_preprocessor.json"
    told = json.loads(file.read_text())
    told["steps"][0]["config"]["rename_map"] = RENAMES
    file.write_text(json.dumps(told))
    return folder
