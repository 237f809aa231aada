"""Train a policy for two steps on a stranger's dataset and act on one of its frames: TYPE
[--policy.OPTION=VALUE ...]

The dataset resembles PushT: one camera, two coordinates, no hand and no target.
"""

import importlib.util
import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDataset
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins

FRAMES, SIDE_PX = 24, 48
CHECKPOINT = Path("run/checkpoints/last/pretrained_model")

kind, options = sys.argv[1], sys.argv[2:]
assert importlib.util.find_spec("dynahoi_lerobot") is None, (
    "the policy must not bring the simulator"
)

image = {"dtype": "image", "shape": (SIDE_PX, SIDE_PX, 3), "names": ["height", "width", "channel"]}
vector = {"dtype": "float32", "shape": (2,), "names": None}
features = {"observation.images.top": image, "observation.state": vector, "action": vector}
dataset = LeRobotDataset.create(
    "a/stranger", fps=10, features=features, root="data", use_videos=False
)
rng = np.random.default_rng(0)
for _ in range(2):
    walk = rng.normal(size=(FRAMES + 1, 2)).cumsum(axis=0).astype(np.float32)
    for here, there in pairwise(walk):
        picture = rng.integers(0, 256, image["shape"], dtype=np.uint8)
        frame = {"observation.images.top": picture, "observation.state": here, "action": there}
        dataset.add_frame(frame | {"task": "catch the ball"})
    dataset.save_episode()
dataset.finalize()

settings = {
    "policy.type": kind,
    "policy.device": "cpu",
    "policy.push_to_hub": False,
    "dataset.repo_id": "a/stranger",
}
settings |= {
    "dataset.root": "data",
    "output_dir": "run",
    "steps": 2,
    "batch_size": 2,
    "save_freq": 2,
    "num_workers": 0,
}
words = [
    f"--{name}={value if isinstance(value, str) else json.dumps(value)}"
    for name, value in settings.items()
]
subprocess.run(["lerobot-train", *words, *options], check=True)

register_third_party_plugins()
config = PreTrainedConfig.from_pretrained(CHECKPOINT)
policy = get_policy_class(config.type).from_pretrained(CHECKPOINT, config=config)
before, after = make_pre_post_processors(config, pretrained_path=str(CHECKPOINT))
seen = LeRobotDataset("a/stranger", root="data")[0]
observation = {name: seen[name] for name in ("observation.images.top", "observation.state", "task")}
action = after(policy.select_action(before(observation)))
assert action.shape[-1] == 2
assert np.isfinite(action.numpy()).all()
