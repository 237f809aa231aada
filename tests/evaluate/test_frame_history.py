"""A policy that remembers frames sees the same ones whether it is asked in every frame or once a chunk."""

from __future__ import annotations

import copy

import pytest
import torch

from dynahoi_lerobot.evaluate.policy_agent import note_frame, queued_frame


@pytest.fixture(scope="module")
def diffusion():
    from lerobot.configs import FeatureType, PolicyFeature
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    config = DiffusionConfig(
        input_features={
            "observation.images.ego": PolicyFeature(FeatureType.VISUAL, (3, 64, 64)),
            "observation.state": PolicyFeature(FeatureType.STATE, (18,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (18,))},
        n_obs_steps=2,
        horizon=8,
        n_action_steps=4,
        down_dims=(16, 32),
        n_groups=4,
        pretrained_backbone_weights=None,
        crop_ratio=1.0,
        noise_scheduler_type="DDIM",
        num_inference_steps=2,
        device="cpu",
    )
    return DiffusionPolicy(config).eval()


def test_diffusion_policy_plans_from_the_noted_frames(diffusion):
    frames = [
        {
            "observation.images.ego": torch.rand(2, 3, 64, 64),
            "observation.state": torch.rand(2, 18),
            "action": None,  # LeRobot's preprocessor leaves this key in every batch
        }
        for _ in range(3)
    ]
    noise = torch.randn(2, 8, 18)
    asked_always, asked_once = copy.deepcopy(diffusion), copy.deepcopy(diffusion)
    for frame in frames:
        asked_always.select_action(dict(frame))
    for frame in frames[:-1]:
        note_frame(asked_once, frame)
    chunk = asked_once.predict_action_chunk(queued_frame(asked_once, frames[-1]), noise=noise)

    expected = asked_always.predict_action_chunk(dict(frames[-1]) | {"observation.images": None}, noise=noise)
    assert chunk.shape == (2, 4, 18)
    torch.testing.assert_close(chunk, expected)
    forgetful = copy.deepcopy(diffusion)
    other = forgetful.predict_action_chunk(queued_frame(forgetful, frames[-1]), noise=noise)
    assert not torch.allclose(chunk, other), "the frames before matter"


def test_a_policy_without_queues_gets_its_batch_unchanged():
    batch = {"observation.state": torch.zeros(1, 18)}
    assert queued_frame(object(), batch) is batch
