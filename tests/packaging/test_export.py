"""``recipes/train/export.py``: the averaged weights alone, the processors, and a card with the results."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import make_pre_post_processors
from lerobot_policy_tracker import TrackerConfig, TrackerPolicy

from tests.report.example_runs import example_run

SCRIPT = Path(__file__).parents[2] / "recipes" / "train" / "export.py"
INPUTS = {
    "observation.images.ego": PolicyFeature(FeatureType.VISUAL, (3, 32, 32)),
    "observation.state": PolicyFeature(FeatureType.STATE, (18,)),
}
OUTPUTS = {"action": PolicyFeature(FeatureType.ACTION, (18,))}
SMALL = {"width": 16, "n_attention_heads": 2, "image_size": 32, "device": "cpu", "push_to_hub": False}


def trained(folder: Path) -> TrackerPolicy:
    """Save a small policy whose averaged weights differ from its newest ones; return it."""
    policy = TrackerPolicy(TrackerConfig(input_features=INPUTS, output_features=OUTPUTS, ema_decay=0.9, **SMALL))
    with torch.no_grad():
        for parameter in policy.model.parameters():
            parameter.add_(torch.randn_like(parameter))
    policy.save_pretrained(folder)
    for pipeline in make_pre_post_processors(policy.config, dataset_stats={}):
        pipeline.save_pretrained(folder)
    return policy


@pytest.mark.slow
def test_an_export_acts_by_the_average_and_shows_its_results(tmp_path: Path) -> None:
    checkpoint, out = tmp_path / "checkpoint", tmp_path / "out"
    average = trained(checkpoint).ema.module.state_dict()
    example_run(tmp_path / "results", "tracker", skill=0.7)
    command = [sys.executable, str(SCRIPT), str(checkpoint), str(tmp_path / "results"), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

    exported = TrackerPolicy.from_pretrained(out)
    assert exported.ema is None
    torch.testing.assert_close(exported.model.state_dict(), average)
    sizes = [(folder / "model.safetensors").stat().st_size for folder in (checkpoint, out)]
    assert sizes[1] < 0.6 * sizes[0]
    make_pre_post_processors(exported.config, pretrained_path=str(out))

    card = (out / "README.md").read_text()
    assert "dynahoi evaluate --policy" in card
    assert "## Results on `test_small`, 44 episodes" in card
    assert "| S_loc | " in card
    assert "| Averaged weights (EMA) | off |" in card
