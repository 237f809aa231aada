"""Play the motion and the object of a third party by their names: env, recording and dataset
command.

Episodes of the benchmark stay as they are pinned.

python -m tests.third_party.by_name FOLDER
"""

import importlib
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np

from benchmarks import pin
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.scene.scene import compile_scene
from tests.tools import generated


def main(folder: Path) -> None:
    before = compile_scene()
    importlib.import_module("tests.third_party.things")
    importlib.import_module("lerobot_policy_forward.task")
    assert compile_scene().target_geoms.size > before.target_geoms.size, (
        "slots are added after the first compilation"
    )
    for split in ("train", "test", "ood_speed"):
        recording = Recording.of(
            split=split, motions=("a_drift",), objects=("caltrop",), image_size=32
        )
        (episode,) = record(recording, [0])
        assert (episode.meta.motion, episode.meta.object, episode.success) == (
            "a_drift",
            "caltrop",
            True,
        )
    (contact,) = record(
        Recording.of(capture="contact", objects=("caltrop",), motions=("constant",), image_size=32),
        [0],
    )
    assert contact.target_contacts.any(), "its solids are touched"
    env = gym.make("dynahoi_lerobot.env:dynahoi/a_drift-v0", image_size=32)
    observation, _ = env.reset(seed=0)
    assert np.ptp(observation["pixels"]["ego"]) > 0
    generated(folder, "--image-size=32", "--motions=a_drift", "--objects=caltrop", episodes=1)
    assert pin.differences(pin.pin(seeds=2, with_images=1), pin.read()) == []


if __name__ == "__main__":
    main(Path(sys.argv[1]))
