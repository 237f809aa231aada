"""Record a scripted pusher in gym-pusht, as a LeRobot dataset from which ObAct learns by its
actions alone.

    uv pip install "lerobot[pusht]"
    python policies/lerobot_policy_obact/examples/pusht.py --root data/pusht --episodes 120 --seed
    1000

The pusher tries straight pushes on a copy of the simulation, keeps the one that brings the block
nearest to its goal, walks around the block to where that push begins, and pushes. The package's
README trains on its recordings.
"""

import argparse
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

ENV = "gym_pusht:gym_pusht/PushT-v0"
IMAGE_PX, LONGEST_STEPS = 96, 200
STRIDE, CLEARANCE, ARENA = 22.0, 115.0, (20.0, 492.0)
"""How far the pusher goes in a step, how far from the block's center it walks around it, and where
it may be [px]."""
BEARINGS, OFFSETS, DEPTHS = 12, (-35.0, 0.0, 35.0), (70.0, 40.0, 10.0)
"""Pushes that are tried: directions, distances of their line from the block's center and where they
end before it."""
RADIAN_PX = 60.0  # an angle of one radian counts as much as so many pixels
FEATURES = {
    "observation.image": {
        "dtype": "video",
        "shape": (IMAGE_PX, IMAGE_PX, 3),
        "names": ["height", "width", "channels"],
    },
    "observation.state": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
    "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
}


def walk(places: np.ndarray) -> np.ndarray:
    """Return the commands, ``(N, 2)``, that walk through places ``(P, 2)``, the first of which is
    where it stands.
    """
    legs = [
        np.linspace(a, b, max(1, int(np.ceil(np.linalg.norm(b - a) / STRIDE))) + 1)[1:]
        for a, b in pairwise(places)
    ]
    return np.clip(np.concatenate(legs), *ARENA)


class Pusher:
    """Plans pushes in an env of its own, which has no images."""

    def __init__(self) -> None:
        self.twin: Any = gym.make(ENV, obs_type="state").unwrapped
        self.twin.reset(seed=0)

    def cost(self, env: Any) -> float:
        """Return how far the block is from its goal [px]."""
        *place, angle = env.goal_pose
        turn = (env.block.angle - angle + np.pi) % (2 * np.pi) - np.pi
        return float(np.linalg.norm(np.array(env.block.position) - place) + RADIAN_PX * abs(turn))

    def pushes(self, centre: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield where each push begins and ends."""
        for bearing in np.arange(BEARINGS) * 2 * np.pi / BEARINGS:
            outward = np.array([np.cos(bearing), np.sin(bearing)])
            line = centre + np.array([-outward[1], outward[0]]) * np.array(OFFSETS)[:, None]
            for middle in line:
                begin = middle + CLEARANCE * outward
                if np.all((begin >= ARENA[0]) & (begin <= ARENA[1])):
                    yield from ((begin, middle + depth * outward) for depth in DEPTHS)

    def tried(self, env: Any, begin: np.ndarray, end: np.ndarray) -> float:
        """Return the cost after a push in the twin."""
        twin = self.twin
        for body, other in ((twin.agent, env.agent), (twin.block, env.block)):
            body.position, body.angle = other.position, other.angle
            body.velocity, body.angular_velocity = (0, 0), 0
        twin.agent.position = tuple(begin)
        for body in (twin.agent, twin.block):
            twin.space.reindex_shapes_for_body(body)
        for command in walk(np.array([begin, end, begin])):
            twin.step(command)
        return self.cost(twin)

    def plan(self, env: Any) -> np.ndarray:
        """Return the commands of the best push, with the way to it and back, ``(N, 2)``; none if no
        push helps.
        """
        centre, here = (
            np.array(env.block.local_to_world(env.block.center_of_gravity)),
            np.array(env.agent.position),
        )
        options = [(self.tried(env, begin, end), begin, end) for begin, end in self.pushes(centre)]
        best, begin, end = min(options, key=lambda option: option[0])
        if best >= self.cost(env) - 1:
            return np.empty((0, 2))
        return walk(np.array([here, *around(centre, here, begin), begin, end, begin]))


def around(centre: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return places on a circle about the block from the bearing of one place to that of another,
    ``(N, 2)``.
    """
    first, last = (np.arctan2(*(place - centre)[::-1]) for place in (here, there))
    turn = (last - first + np.pi) % (2 * np.pi) - np.pi
    bearings = first + np.linspace(0, turn, max(2, int(abs(turn) / 0.3) + 1))
    return np.clip(
        centre + CLEARANCE * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1), *ARENA
    )


def demonstrate(
    env: Any, pusher: Pusher, seed: int
) -> Iterator[tuple[dict[str, Any], np.ndarray, float]]:
    """Play an episode; yield each observation, the command given to it and the coverage that it led
    to.
    """
    seen, _ = env.reset(seed=seed)
    for _ in range(LONGEST_STEPS):
        commands = pusher.plan(env.unwrapped)
        if not len(commands):
            return
        for command in commands:
            before = seen
            seen, _, done, _, info = env.step(command.astype(np.float32))
            yield before, command, float(info["coverage"])
            if done:
                return


def main() -> None:
    """Record the dataset and print how much of the goal the block covered."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first episode")
    args = parser.parse_args()
    env = gym.make(ENV, obs_type="pixels_agent_pos", max_episode_steps=LONGEST_STEPS)
    dataset = LeRobotDataset.create(
        "local/pusht", fps=10, features=FEATURES, root=args.root, use_videos=True
    )
    pusher, covered = Pusher(), []
    for seed in range(args.seed, args.seed + args.episodes):
        coverage = 0.0
        for step, (seen, command, now) in enumerate(demonstrate(env, pusher, seed)):
            if step == LONGEST_STEPS:
                break
            frame = {
                "observation.image": seen["pixels"],
                "observation.state": seen["agent_pos"].astype(np.float32),
            }
            dataset.add_frame(
                {**frame, "action": command.astype(np.float32), "task": "Push the T onto its goal."}
            )
            coverage = max(coverage, now)
        dataset.save_episode()
        covered.append(coverage)
    dataset.finalize()
    print(f"{args.episodes} episodes, mean of the best coverage {np.mean(covered):.2f}")


if __name__ == "__main__":
    main()
