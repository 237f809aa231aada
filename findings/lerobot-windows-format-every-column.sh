#!/usr/bin/env bash
# LeRobot 0.6.1 with datasets 4.8.5.
# Expected: delta_timestamps over one key read the frames of its window from the column of that key, as the code says,
# `hf_dataset[key][indices]`; columns that nobody asks for cost nothing but the current frame.
# Seen: datasets hands a custom transform, such as LeRobot's, whole rows, also for a single column. So every key with a
# window formats all columns for all frames of that window, and a sample costs keys x frames x columns.
# Met by: who trains on long windows of several keys, and wonders why the loader, without any image, keeps a core busy;
# without the columns that the policy does not read, a sample loads several times as fast.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export HF_HOME="$dir/hub" HF_LEROBOT_HOME="$dir/lerobot" HF_HUB_OFFLINE=1
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet 'lerobot[dataset]==0.6.1' 'datasets==4.8.5'
"$dir/venv/bin/python" - "$dir" 2>"$dir/log" <<'EOF' || { tail -n 5 "$dir/log" >&2; exit 1; }
import sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

WINDOW = 30


def formatted(n_unread):
    """Return how many values of other columns are formatted for one sample with a window of states."""
    names = ["observation.state", *(f"unread_{i}" for i in range(n_unread))]
    features = {name: {"dtype": "float32", "shape": (1,), "names": ["x"]} for name in names}
    root = f"{sys.argv[1]}/{n_unread}"
    dataset = LeRobotDataset.create("local/x", fps=10, features=features, root=root, use_videos=False)
    for t in range(100):
        dataset.add_frame({name: np.float32([t]) for name in names} | {"task": "x"})
    dataset.save_episode()
    dataset.finalize()
    deltas = {"observation.state": [i / 10 for i in range(WINDOW)]}
    dataset = LeRobotDataset("local/x", root=root, delta_timestamps=deltas)
    transform = dataset.hf_dataset.format["format_kwargs"]["transform"]
    counts = []

    def counting(rows):
        counts.append(sum(len(values) for name, values in rows.items() if name.startswith("unread")))
        return transform(rows)

    dataset.hf_dataset.set_transform(counting)
    assert dataset[20]["observation.state"].shape[0] == WINDOW
    return sum(counts)


for n in (0, 10, 20):
    found = formatted(n)
    print(f"{n:2} columns that nobody reads: {found} of their values are formatted for a sample")
    assert found == n * (1 + WINDOW), f"{n} columns cost {found} values now, {n} would do for the current frame"
EOF
