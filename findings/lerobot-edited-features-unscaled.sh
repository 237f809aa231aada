#!/usr/bin/env bash
# LeRobot 0.6.1.
# Expected: modify_features computes statistics for the column it adds (its log says that statistics are recalculated),
# and convert_image_to_video_dataset keeps those of its cameras.
# Seen: neither appears in meta/stats.json, and the normaliser passes a feature without statistics through unscaled,
# without a warning. recompute_stats afterwards helps the column; for cameras it does not even when asked to.
# Met by: who adds a goal in millimetres, or turns an image dataset into videos, and then trains with MEAN_STD.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export HF_HOME="$dir/hub" HF_LEROBOT_HOME="$dir/lerobot" HF_HUB_OFFLINE=1
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet 'lerobot[dataset]==0.6.1'
"$dir/venv/bin/python" - "$dir" 2>"$dir/log" <<'EOF' || { tail -n 5 "$dir/log" >&2; exit 1; }
import sys
import numpy as np
import torch
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets import dataset_tools as tools
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.processor import NormalizerProcessorStep, TransitionKey

root, camera, goal = sys.argv[1], "observation.images.top", "observation.goal_mm"
features = {camera: {"dtype": "image", "shape": (64, 64, 3), "names": ["height", "width", "channels"]}}
source = LeRobotDataset.create("local/a", fps=10, features=features, root=f"{root}/a", use_videos=False)
for grey in range(0, 250, 10):
    source.add_frame({camera: np.full((64, 64, 3), grey, np.uint8), "task": "reach"})
source.save_episode()
source.finalize()
source = LeRobotDataset("local/a", root=f"{root}/a")
values = np.random.default_rng(0).normal(400, 50, (25, 3)).astype(np.float32)
column = (values, {"dtype": "float32", "shape": (3,), "names": ["x", "y", "z"]})
added = tools.modify_features(source, {goal: column}, output_dir=f"{root}/added", repo_id="local/added")
videos = tools.convert_image_to_video_dataset(source, f"{root}/videos", "local/videos")
normalise = NormalizerProcessorStep(
    features={goal: PolicyFeature(FeatureType.STATE, (3,))},
    norm_map={FeatureType.STATE: NormalizationMode.MEAN_STD},
    stats=added.meta.stats,
)
batch = {goal: torch.from_numpy(values)}
scaled = normalise({TransitionKey.OBSERVATION: batch})[TransitionKey.OBSERVATION][goal]
for dataset in (source, added, videos):
    print(dataset.repo_id, "has statistics of", sorted(key for key in dataset.meta.stats if "." in key))
print("the column after the normaliser has mean", round(scaled.mean().item(), 1))
assert camera in source.meta.stats and camera not in videos.meta.stats, "videos have statistics now"
assert goal not in added.meta.stats and torch.equal(scaled, batch[goal]), "an added column has statistics now"
assert goal in tools.recompute_stats(added).meta.stats
assert camera not in tools.recompute_stats(videos, skip_image_video=False).meta.stats
EOF
