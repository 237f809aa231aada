#!/usr/bin/env bash
# Minari 0.5.4.
# Expected: DataCollector stores observations as they are, uint8 images included; HDF5 compresses without loss.
# Seen: every Box of uint8 that looks like an image is stored as JPEG by default, in HDF5 and Arrow alike, and comes
# back changed: a segmentation in two pure colours has hundreds. jpeg_encoding=False keeps the pixels. Pillow, which
# it needs, is not among its dependencies.
# Met by: who collects label maps, depth packed in colours, or pixels to compare exactly between two runs.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
uv venv --quiet --python 3.12 "$dir/venv"
VIRTUAL_ENV="$dir/venv" uv pip install --quiet 'minari[hdf5,arrow,create]==0.5.4' gymnasium==1.4.0 pillow==13.0.0
export MINARI_DATASETS_PATH="$dir/data"
"$dir/venv/bin/python" - 2>"$dir/log" <<'EOF' || { tail -n 5 "$dir/log" >&2; exit 1; }
import gymnasium as gym
import minari
import numpy as np

RED, GREEN = (255, 0, 0), (0, 255, 0)
disc = np.hypot(*np.mgrid[-32:32, -32:32]) < 20
LABELS = np.where(disc[..., None], np.uint8(RED), np.uint8(GREEN))


class Segmentation(gym.Env):
    observation_space = gym.spaces.Box(0, 255, LABELS.shape, np.uint8)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return LABELS.copy(), {}

    def step(self, action):
        return LABELS.copy(), 0.0, True, False, {}


def colours(name, **options):
    collector = minari.DataCollector(Segmentation(), **options)
    collector.reset()
    collector.step(collector.action_space.sample())
    dataset = collector.create_dataset(f"local/{name}-v0", description="two labels", algorithm_name="none")
    stored = np.asarray(next(dataset.iterate_episodes()).observations[0])
    print(f"{name}: {len(np.unique(stored.reshape(-1, 3), axis=0))} colours")
    return stored


for data_format in ("hdf5", "arrow"):
    assert not np.array_equal(colours(data_format, data_format=data_format), LABELS), "stored without loss now"
assert np.array_equal(colours("exact", jpeg_encoding=False), LABELS)
EOF
