#!/usr/bin/env bash
# LeRobot 0.6.1.
# Expected: meta/stats.json holds the standard deviation and the mean of what was recorded.
# Seen: both come from running sums of x and x^2 in float32. A tool held at 1000 mm with 0.05 mm of noise gets ten
# times its standard deviation, a barometer at 101 325 Pa with 2 Pa fourteen times, and a camera that sees constant
# grey 200 gets the mean 197.8 and a deviation of 37 grey levels.
# Met by: who records millimetres, pressures or encoder counts and trains a policy that divides by this deviation.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export HF_HOME="$dir/hub" HF_LEROBOT_HOME="$dir/lerobot" HF_HUB_OFFLINE=1
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet 'lerobot[dataset]==0.6.1' numpy==2.2.6
"$dir/venv/bin/python" - "$dir/data" 2>"$dir/log" <<'EOF' || { tail -n 5 "$dir/log" >&2; exit 1; }
import sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

names = ["height", "width", "channels"]
features = {
    "observation.state": {"dtype": "float32", "shape": (2,), "names": ["tool_mm", "pressure_pa"]},
    "observation.images.top": {"dtype": "image", "shape": (96, 96, 3), "names": names},
}
dataset = LeRobotDataset.create("local/held", fps=30, features=features, root=sys.argv[1], use_videos=False)
rng = np.random.default_rng(0)
state = rng.normal([1000, 101_325], [0.05, 2.0], (4, 300, 2)).astype(np.float32)
image = np.full((96, 96, 3), 200, np.uint8)
for episode in state:
    for frame in episode:
        dataset.add_frame({"observation.state": frame, "observation.images.top": image, "task": "hold"})
    dataset.save_episode()
dataset.finalize()
stats = dataset.meta.stats
true, stored = state.astype(np.float64).std((0, 1)), stats["observation.state"]["std"]
mean, std = (255 * stats["observation.images.top"][key].flatten()[0] for key in ("mean", "std"))
print("standard deviation recorded", true.round(3), "stored", stored.round(3))
print(f"image of constant 200: mean {mean:.1f}, standard deviation {std:.1f}")
assert (stored > 3 * true).all(), "the deviation is no longer far too large"
assert mean < 199 and std > 10, "the statistics of a constant image are right now"
EOF
