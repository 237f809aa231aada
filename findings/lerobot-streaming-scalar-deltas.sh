#!/usr/bin/env bash
# LeRobot 0.6.1.
# Expected: StreamingLeRobotDataset yields the types and shapes of LeRobotDataset, so delta_timestamps over a column of
# shape (1,), say a gripper, a reward or a one-joint action, give a tensor (T,) either way.
# Seen: in memory such a column is a tensor (), streamed it is a Python float, int or bool, and delta_timestamps over
# it raise a TypeError at the first frame. Columns of two and more numbers stream as tensors.
# Met by: who trains an action-chunking policy from a stream on a gripper alone, or samples rewards ahead.
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
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

features = {
    "action": {"dtype": "float32", "shape": (1,), "names": ["gripper"]},
    "observation.state": {"dtype": "float32", "shape": (2,), "names": ["joint", "gripper"]},
}
dataset = LeRobotDataset.create("local/grip", fps=10, features=features, root=sys.argv[1], use_videos=False)
for t in range(20):
    dataset.add_frame({"action": np.float32([t]), "observation.state": np.float32([0, t]), "task": "grip"})
dataset.save_episode()
dataset.finalize()


def first(kind, key=None):
    deltas = {key: [0.0, 0.1, 0.2]} if key else None
    return next(iter(kind("local/grip", root=sys.argv[1], delta_timestamps=deltas)))


print("in memory:", repr(first(LeRobotDataset)["action"]), first(LeRobotDataset, "action")["action"])
print("streamed: ", repr(first(StreamingLeRobotDataset)["action"]))
assert isinstance(first(StreamingLeRobotDataset)["action"], float), "a stream yields tensors now"
assert first(StreamingLeRobotDataset, "observation.state")["observation.state"].shape == (3, 2)
try:
    first(StreamingLeRobotDataset, "action")
except TypeError as error:
    print("streamed with delta_timestamps: TypeError:", error)
else:
    sys.exit("deltas over a column of shape (1,) stream now")
EOF
