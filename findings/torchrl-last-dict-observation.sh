#!/usr/bin/env bash
# TorchRL 0.14.1 with Gymnasium 1.4.0.
# Expected: under SAME_STEP autoreset ("next", KEY) ends an episode with its true last observation, Box or Dict.
# Seen: right for a Box; of a Dict every entry of the last observation is zero, with no warning. The first observation
# of the following episode is right, and so is everything with autoreset DISABLED.
# Met by: who trains on state and camera together: the value at a time limit is bootstrapped from a black image.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export RL_LOGGING_LEVEL=WARNING
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet torchrl==0.14.1 gymnasium==1.4.0
"$dir/venv/bin/python" - 2>"$dir/log" <<'EOF' || { tail -n 5 "$dir/log" >&2; exit 1; }
import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torchrl.envs import GymWrapper


class Count(gym.Env):  # observes ten and the number of its steps; an episode has three
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, as_dict):
        box = gym.spaces.Box(0, 99, (1,), np.float32)
        self.as_dict = as_dict
        self.observation_space = gym.spaces.Dict(position=box) if as_dict else box

    def reset(self, *, seed=None, options=None):
        self.steps = -1
        return self.step(None)[0], {}

    def step(self, action):
        self.steps += 1
        value = np.float32([10 + self.steps])
        return {"position": value} if self.as_dict else value, 0.0, False, self.steps == 3, {}


def following(as_dict, mode):
    env = GymWrapper(SyncVectorEnv([lambda: Count(as_dict)] * 2, autoreset_mode=mode))
    seen = env.rollout(5, break_when_any_done=False)["next", "position" if as_dict else "observation"]
    print(f"{'Dict' if as_dict else 'Box'}, {mode.name}:", *seen[0, :, 0].int().tolist())
    return seen[0, :, 0].tolist()


right = [11, 12, 13, 11, 12]
assert following(False, AutoresetMode.SAME_STEP) == right
assert following(True, AutoresetMode.DISABLED) == right
assert following(True, AutoresetMode.SAME_STEP) == [11, 12, 0, 11, 12], "the last observation is kept now"
EOF
