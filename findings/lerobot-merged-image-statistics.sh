#!/usr/bin/env bash
# LeRobot 0.6.1.
# Expected: merge_datasets weights the image statistics of its sources by their frames, so two recordings of equal
# length, one grey 50 and one grey 200, merge to a mean of 125.
# Seen: a recording with streaming_encoding=True stores the number of pixels as its count, one without it the number
# of frames it sampled. At 96 x 96 the streamed one weighs 18 432 times as much, and the other vanishes.
# Met by: who switches streaming encoding on between two recording sessions and merges them for training.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export HF_HOME="$dir/hub" HF_LEROBOT_HOME="$dir/lerobot" HF_HUB_OFFLINE=1
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet 'lerobot[dataset]==0.6.1'
"$dir/venv/bin/python" - "$dir/data" 2>"$dir/log" <<'EOF' || { tail -n 5 "$dir/log" >&2; exit 1; }
import sys
import numpy as np
from lerobot.datasets.dataset_tools import merge_datasets
from lerobot.datasets.lerobot_dataset import LeRobotDataset

camera = "observation.images.top"
features = {camera: {"dtype": "video", "shape": (96, 96, 3), "names": ["height", "width", "channels"]}}


def record(name, grey, streaming):
    root = f"{sys.argv[1]}/{name}"
    dataset = LeRobotDataset.create(
        f"local/{name}", fps=30, features=features, root=root, streaming_encoding=streaming
    )
    for _ in range(200):
        dataset.add_frame({camera: np.full((96, 96, 3), grey, np.uint8), "task": "look"})
    dataset.save_episode()
    dataset.finalize()
    return LeRobotDataset(f"local/{name}", root=root)


sources = [record("streamed", 50, True), record("encoded-after", 200, False)]
merged = merge_datasets(sources, "local/merged", f"{sys.argv[1]}/merged")
for dataset in (*sources, merged):
    stats = dataset.meta.stats[camera]
    print(f"{dataset.repo_id}: count {stats['count'][0]}, mean {255 * stats['mean'].mean():.2f}")
assert 255 * merged.meta.stats[camera]["mean"].mean() < 51, "the second recording counts now"
EOF
