"""What learning from a policy's own episodes costs in memory, and through a dataset on disk.

python benchmarks/onpolicy_data.py [--episodes 64] [--updates 8] [--turns 2] [--json FILE]

Both ways in turns in one run (A B A B), on one thread, in processor seconds per 64 episodes; learning per 1,000
decisions, as an update takes whole episodes in memory and single frames from a dataset. The policy is that of
recipes/train/standard.yaml with random weights, so its episodes are as long as they get.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import draccus
import numpy as np
import torch
import yaml
from lerobot.configs.train import TrainPipelineConfig
from lerobot_policy_tracker.learner import TrackerLearner, make_learner
from support.options import benchmark_parser, write_numbers
from tracker_training import Watch, read_and_update

from dynahoi_lerobot.dataset import write_episodes
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.onpolicy.actor import actor_name, make_actor, open_policy, runtime
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, read_recipe
from dynahoi_lerobot.onpolicy.rounds import play_round
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.rollout.on_policy import record_on_policy
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

RECIPE = Path(__file__).parents[1] / "recipes" / "train" / "standard.yaml"
TINY = {"episodes": 2, "updates": 1, "turns": 1, "batch_size": 2, "image_size": 32}
PER_EPISODES, PER_DECISIONS, SHARE = 64, 1000, 0.15


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--updates", type=int, default=8)
    parser.add_argument("--turns", type=int, default=2, help="how often each way is measured")
    parser.add_argument("--batch-size", type=int, default=32, help="frames of an update from a dataset")
    parser.add_argument("--image-size", type=int, default=64)
    args = parser.parse_args()
    torch.set_num_threads(1)
    ways: dict[str, Callable[..., dict[str, float]]] = {"in memory": in_memory, "dataset": through_a_dataset}
    measured: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as folder:
        learner = random_learner(args.image_size, args.episodes)
        for turn in range(args.turns):
            for name, way in ways.items():
                measured[name].append(way(learner, args, Path(folder) / str(turn)))
    table = {
        name: {part: statistics.median(m[part] for m in found) for part in found[0]} for name, found in measured.items()
    }
    for name, parts in table.items():
        print(f"{name}: " + ", ".join(f"{part} {seconds:.2f} s" for part, seconds in parts.items()))
    write_numbers(args, processor_seconds=table, turns=measured)


def random_learner(image_size: int, episodes: int) -> TrackerLearner:
    """Return a learner of the recipe's policy that has learned nothing."""
    recipe = read_recipe(DaggerRecipe, RECIPE, worlds=episodes, batch_episodes=episodes)
    policy = dict(recipe.policy) | {"backbone_options": {}, "image_size": image_size}
    image = {"observation.images.ego": {"type": "VISUAL", "shape": [3, image_size, image_size]}}
    recipe.policy.update(policy | {"input_features": recipe.policy["input_features"] | image})
    return make_learner(recipe)


def in_memory(learner: TrackerLearner, args: Any, folder: Path) -> dict[str, float]:
    """Play a round and learn from it as `dynahoi dagger` does; return processor times by part."""
    recipe = recorded_recipe(args.image_size)
    batch, parts = make_batch(recipe, args.episodes, threads=1), Watch()
    learner.lessons.clear()
    with parts("play"):
        specs = sample_specs(recipe, range(args.episodes))
        learner.study(play_round(batch, learner, specs, np.random.default_rng(0), SHARE))
    with parts("learn"):
        learner.learn(args.updates)
    decisions = args.updates * int(learner.lessons[0].keep.sum())
    return per_unit(parts, args.episodes, decisions)


def through_a_dataset(learner: TrackerLearner, args: Any, folder: Path) -> dict[str, float]:
    """Record the same episodes, write them, merge and learn from them as `lerobot-train` does; likewise."""
    learner.save_pretrained(folder / "policy")
    path = str(folder / "policy")
    recipe = recorded_recipe(args.image_size, actor=actor_name(path), teacher_share=SHARE)
    make, parts = partial(make_actor, path=path, name=recipe.actor, on=runtime(open_policy(path))), Watch()
    make(0)  # loading it is not counted
    with parts("play"):
        episodes = list(record_on_policy(recipe, range(args.episodes), make_agent=make, threads=1))
    with parts("write"):
        write_episodes(folder / "data", episodes)
    with parts("merge"):
        merge([folder / "data"], folder / "merged")
    config = training(learner, folder)
    words = [f"--dataset.root={folder / 'merged'}", f"--batch_size={args.batch_size}"]
    updating = Watch()
    read_and_update(draccus.parse(TrainPipelineConfig, config, args=words), args.updates, updating)
    parts.parts["learn"] = [sum(map(sum, updating.parts.values()))]
    return per_unit(parts, args.episodes, args.updates * args.batch_size)


def recorded_recipe(image_size: int, **changes: Any) -> Recipe:
    """Return the recipe of the episodes."""
    return Recipe(control_class="standard", image_size=image_size, **changes)


def training(learner: TrackerLearner, folder: Path) -> Path:
    """Write the configuration with which `lerobot-train` trains the same policy from a dataset."""
    policy = learner.recipe.policy | {"privileged_key": "target.pose", "privileged_weight": 0.0}
    path = folder / "train.yaml"
    path.write_text(yaml.safe_dump({"dataset": {"repo_id": "local/data"}, "policy": policy}))
    return path


def per_unit(parts: Watch, episodes: int, decisions: int) -> dict[str, float]:
    """Return processor seconds of each part per 64 episodes, of learning per 1,000 decisions."""
    scale = {"learn": PER_DECISIONS / decisions}
    return {name: sum(seconds) * scale.get(name, PER_EPISODES / episodes) for name, seconds in parts.parts.items()}


if __name__ == "__main__":
    main()
