"""How fast the default policy trains and acts on this machine.

python benchmarks/tracker_latency.py [--json FILE] [--threads 2] [--set n_decisions=4 --set image_size=96 ...]

Synthetic batches in the layout of the catching task; the loader and the simulator are not part of it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot_policy_tracker import TrackerConfig, TrackerPolicy
from support.options import benchmark_parser, write_numbers

VECTORS = {"observation.state": 18, "observation.phase": 2}
IMAGE = "observation.images.ego"
MIN_CALLS = 5
TINY = {"batch_size": 1, "image_px": 32, "min_seconds": 0.0, "threads": 1, "set": ["width=32", "n_decisions=1"]}


def make_policy(image_px: int, **settings: Any) -> TrackerPolicy:
    """Return an untrained policy for the catching task with images of ``image_px`` [px]."""
    inputs = {key: PolicyFeature(FeatureType.STATE, (size,)) for key, size in VECTORS.items()}
    inputs[IMAGE] = PolicyFeature(FeatureType.VISUAL, (3, image_px, image_px))
    outputs = {"action": PolicyFeature(FeatureType.ACTION, (18,))}
    return TrackerPolicy(TrackerConfig(input_features=inputs, output_features=outputs, device="cpu", **settings))


def make_batch(policy: TrackerPolicy, n: int, image_px: int) -> dict[str, Any]:
    """Return a random training batch of ``n`` samples."""
    n_frames, n_actions = len(policy.config.observation_delta_indices), len(policy.config.action_delta_indices)
    batch = {key: torch.randn(n, n_frames, size) for key, size in VECTORS.items()}
    batch[IMAGE] = torch.rand(n, n_frames, 3, image_px, image_px)
    return batch | {"action": torch.randn(n, n_actions, 18), "task": ["catch the ball"] * n}


def seconds_per_call(call: Callable[[], Any], min_seconds: float) -> float:
    """Return the median time of a call [s], after one that warms up; call for at least ``min_seconds``."""
    call()
    times: list[float] = []
    while len(times) < MIN_CALLS or sum(times) < min_seconds:
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return sorted(times)[len(times) // 2]


def measure(batch_size: int, image_px: int, min_seconds: float, settings: dict[str, Any]) -> dict[str, float]:
    """Return parameters [M], training steps and decisions per second, and latencies [ms].

    ``chunk_latency_ms`` encodes a whole window; ``step_latency_ms`` the newest frame alone, as acting does.
    """
    policy = make_policy(image_px, **settings)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-4)
    batch = make_batch(policy, batch_size, image_px)

    def step() -> None:
        policy.train()
        policy(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()

    steps_per_s = 1 / seconds_per_call(step, min_seconds)
    window = {key: value[:1] for key, value in batch.items()}
    frame = {key: value if key == "task" else value[:, -1] for key, value in window.items()}
    for _ in range(len(policy.config.windows.lookback) * policy.config.obs_stride):
        policy.predict_action_chunk(frame)
    return {
        "parameters_m": sum(p.numel() for p in policy.model.parameters()) / 1e6,
        "train_steps_per_s": steps_per_s,
        "train_decisions_per_s": steps_per_s * batch_size * policy.config.n_decisions,
        "chunk_latency_ms": 1e3 * seconds_per_call(lambda: policy.predict_action_chunk(window), min_seconds),
        "step_latency_ms": 1e3 * seconds_per_call(lambda: policy.predict_action_chunk(frame), min_seconds),
    }


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--min-seconds", type=float, default=5.0, help="least time of each measurement [s]")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--batch-size", type=int, default=32)
    parser.add_argument("--image-px", type=int, default=96, help="size of the images in the data")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting of TrackerConfig")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    settings = {name: json.loads(value) for name, value in (item.split("=", 1) for item in args.set)}
    numbers = measure(args.batch_size, args.image_px, args.min_seconds, settings)
    for name, value in numbers.items():
        print(f"{name:24s} {value:8.2f}")
    write_numbers(args, numbers=numbers)


if __name__ == "__main__":
    main()
