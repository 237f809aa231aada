#!/usr/bin/env bash
# LeRobot 0.6.1.
# Expected: an episode of several tasks numbers them in the order in which they first appear, so the same script
# writes the same task_index column every time.
# Seen: save_episode numbers new tasks in the order of a Python set of strings, which the interpreter's hash seed
# decides. The same frames give other numbers from run to run; with PYTHONHASHSEED fixed they stay.
# Met by: who labels subtasks frame by frame and compares checksums of datasets, caches features by task_index, or
# trains a policy with one head per task.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export HF_HOME="$dir/hub" HF_LEROBOT_HOME="$dir/lerobot" HF_HUB_OFFLINE=1
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet 'lerobot[dataset]==0.6.1'
cat >"$dir/record.py" <<'EOF'
import sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

features = {"action": {"dtype": "float32", "shape": (2,), "names": None}}
dataset = LeRobotDataset.create("local/steps", fps=10, features=features, root=sys.argv[1], use_videos=False)
for task in ("reach", "grasp", "lift", "place", "retreat"):
    dataset.add_frame({"action": np.zeros(2, np.float32), "task": task})
dataset.save_episode()
dataset.finalize()
print(*(int(index) for index in LeRobotDataset("local/steps", root=sys.argv[1]).hf_dataset["task_index"]))
EOF
record() { # HASH_SEED: the task_index column that one run of the script writes
    rm -rf "$dir/data"
    PYTHONHASHSEED=$1 "$dir/venv/bin/python" "$dir/record.py" "$dir/data" 2>"$dir/log" ||
        { tail -n 5 "$dir/log" >&2; exit 1; }
}
for seed in 1 2 3; do
    record "$seed" | tee -a "$dir/columns"
done
[ "$(sort -u "$dir/columns" | wc -l)" -gt 1 ] || { echo "the numbers no longer depend on the hash seed" >&2; exit 1; }
[ "$(record 1)" = "$(head -n 1 "$dir/columns")" ] || { echo "one hash seed gives two columns" >&2; exit 1; }
