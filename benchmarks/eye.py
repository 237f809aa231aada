"""How well an eye sees where the target is: errors along and across the line of sight, by distance from the palm.

python benchmarks/eye.py --eye outputs/eye/eye.safetensors [--pictures 4096] [--split val] [--json FILE]

Random poses of episodes of a split that the eye was not trained on; only targets within the image count.
"""

from __future__ import annotations

from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import torch
from lerobot_policy_obact.backbones.eye import EyeBackbone
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.onpolicy.snapshots import snapshots
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

TINY = {"pictures": 32, "episodes": 2, "batch_size": 16}
EDGES_M = (0.0, 0.06, 0.10, 0.15, 0.25, 0.40, 0.60, np.inf)


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--eye", type=Path, help="weights; random ones if left out")
    parser.add_argument("--split", default="val")
    parser.add_argument("--episodes", type=int, default=220)
    parser.add_argument("--pictures", type=int, default=8192)
    parser.add_argument("--batch-size", type=int, default=128)
    parser.add_argument("--image-size", type=int, default=64)
    args = parser.parse_args()
    torch.set_num_threads(1)
    recipe = Recipe(split=args.split, image_size=args.image_size)
    specs = sample_specs(recipe, range(args.episodes))
    eye = EyeBackbone(128, weights="" if args.eye is None else str(args.eye)).eval()
    eye.load_pretrained()
    stream = snapshots(recipe, specs, args.batch_size, np.random.default_rng(1))
    errors = [_errors(eye, shown) for shown in islice(stream, args.pictures // args.batch_size)]
    rows = _table(np.concatenate(errors))
    print("distance [cm]   pictures   median (90 %) error along / across the line of sight [cm]")
    for row in rows:
        along, across = row["along_cm"], row["across_cm"]
        told = f"{along[0]:5.1f} ({along[1]:5.1f}) / {across[0]:5.2f} ({across[1]:5.2f})"
        print(f"{row['from_cm']:5.0f} to {row['to_cm'] or np.inf:4.0f} {row['pictures']:9d}      {told}")
    write_numbers(args, rows=rows)


@torch.no_grad()
def _errors(eye: EyeBackbone, shown: object) -> np.ndarray:
    """Return (n, 3): distance from the palm, error along and across the line of sight [m] of targets in the image."""
    offset = torch.from_numpy(shown.offset)
    looks = eye.look(torch.from_numpy(shown.images).permute(0, 3, 1, 2) / 255.0)
    sight = torch.nn.functional.normalize(offset - eye.camera_pos, dim=-1)
    missed = looks[:, :3] - offset
    along = (missed * sight).sum(-1, keepdim=True)
    across = (missed - along * sight).norm(dim=-1, keepdim=True)
    inside = (eye.camera_coordinates(offset)[:, :2].abs() < 1).all(-1)
    return torch.cat([offset.norm(dim=-1, keepdim=True), along.abs(), across], dim=-1)[inside].numpy()


def _table(errors: np.ndarray) -> list[dict[str, object]]:
    rows = []
    for low, high in pairwise(EDGES_M):
        some = 100 * errors[(errors[:, 0] >= low) & (errors[:, 0] < high)]
        if len(some):
            along, across = (np.quantile(some[:, column], (0.5, 0.9)).tolist() for column in (1, 2))
            bounds = {"from_cm": 100 * low, "to_cm": 100 * high if np.isfinite(high) else None}
            rows.append({**bounds, "pictures": len(some), "along_cm": along, "across_cm": across})
    return rows


if __name__ == "__main__":
    main()
