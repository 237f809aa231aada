"""How well an eye sees where the target is: errors along and across the line of sight.

    python benchmarks/eye.py --eye outputs/eye/eye.safetensors --images 4096 --json FILE
    python benchmarks/eye.py --eye outputs/eye/eye.safetensors --camera side
    python benchmarks/eye.py --visited-by checkpoints/obact_standard --episodes 110

By distance from the palm. It looks at random poses of episodes of a split that the eye was not
trained on, or at what the hand sees while a policy acts, until it could have met the target; only
targets within the image count.
"""

from collections.abc import Iterator
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from einops import rearrange
from lerobot_policy_obact.camera import Pinhole
from lerobot_policy_obact.encoders import Eye
from support.options import benchmark_parser, parse_options, write_numbers

from dynahoi_lerobot.core.conventions import EGO_VIEW, PALM_DOF
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.snapshots import Snapshots, calibration, snapshots
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

TINY = {"images": 32, "episodes": 2, "batch_size": 16}
EDGES_M = (0.0, 0.06, 0.10, 0.15, 0.25, 0.40, 0.60, np.inf)


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--eye", default="ego_96", help="safetensors file, or an eye that ships")
    parser.add_argument("--split", default="val")
    parser.add_argument("--camera", choices=(EGO_VIEW, "side"), default=EGO_VIEW)
    parser.add_argument("--hand", default="capsule")
    parser.add_argument("--episodes", type=int, default=220)
    parser.add_argument("--images", type=int, default=8192)
    parser.add_argument("--batch-size", type=int, default=128)
    parser.add_argument("--image-size", type=int, default=96)
    parser.add_argument(
        "--visited-by", type=Path, help="checkpoint whose images are looked at, not random ones"
    )
    args = parse_options(parser, TINY)
    torch.set_num_threads(1)
    views = () if args.camera == EGO_VIEW else (args.camera,)
    recipe = Recipe.of(split=args.split, image_size=args.image_size, views=views, hand=args.hand)
    specs = sample_specs(recipe, range(args.episodes))
    eye = Eye(weights=args.eye).eval()
    eye.load_pretrained()
    eye_recipe = PretrainRecipe(
        Path(), args.camera, episodes=recipe, n_episodes=1, batch_size=1, images=1
    )
    pose, (focal_px, _, center_px, _) = calibration(eye_recipe)
    camera = Pinhole.from_pose(pose.tolist(), center_px / focal_px, carried=args.camera == EGO_VIEW)
    if args.visited_by is None:
        batch = WorldBatch(recipe.rules, args.batch_size, threads=1)
        random = snapshots(batch, specs, np.random.default_rng(1), args.camera)
        stream = islice(random, args.images // args.batch_size)
    else:
        stream = _visited(PolicyAgent(str(args.visited_by)), recipe, specs, args.camera)
    rows = _table(np.concatenate([_errors(eye, camera, shown) for shown in stream]))
    print("distance [cm]   images   median (90 %) error along / across the line of sight [cm]")
    for row in rows:
        along = row["along_cm"]
        across = row["across_cm"]
        told = f"{along[0]:5.1f} ({along[1]:5.1f}) / {across[0]:5.2f} ({across[1]:5.2f})"
        print(
            f"{row['from_cm']:5.0f} to {row['to_cm'] or np.inf:4.0f} {row['images']:9d}      {told}"
        )
    write_numbers(args, rows=rows)


def _visited(
    policy: PolicyAgent, recipe: Recipe, specs: list[EpisodeSpec], camera: str
) -> Iterator[Snapshots]:
    """Let a policy play each episode in a world of its own, and yield what it sees while it
    acts.
    """
    batch = WorldBatch(recipe.rules, len(specs), threads=1)
    for episode in evaluate(batch, policy, specs, images=True):
        end = min(episode.meta.intercept_frame, len(episode))
        acting = np.arange(episode.meta.window_frames, end)
        target = episode.target_pose_h[acting, :PALM_DOF]
        from_palm = target - episode.state[acting, :PALM_DOF]
        place = from_palm if camera == EGO_VIEW else target
        images = episode.images[camera]
        yield Snapshots(
            np.concatenate([images[acting], images[acting - 1]], axis=-1),
            place.astype(np.float32),
            from_palm,
        )


@torch.no_grad()
def _errors(eye: Eye, camera: Pinhole, shown: Snapshots) -> np.ndarray:
    """Return (n, 3): distance from the palm, error along and across the line of sight [m] of
    targets in the image.
    """
    place = torch.from_numpy(shown.place)
    sighting = eye(rearrange(torch.from_numpy(shown.images), "f h w c -> f c h w") / 255.0)
    sight = torch.nn.functional.normalize(place - camera.pos, dim=-1)
    missed = camera.unproject(sighting[:, :3]) - place
    along = (missed * sight).sum(-1, keepdim=True)
    across = (missed - along * sight).norm(dim=-1, keepdim=True)
    inside = (camera.project(place)[:, :2].abs() < 1).all(-1)
    distance = torch.from_numpy(shown.from_palm).norm(dim=-1, keepdim=True)
    return torch.cat([distance, along.abs(), across], dim=-1)[inside].numpy()


def _table(errors: np.ndarray) -> list[dict[str, Any]]:
    """Return a row for each range of distances in which there are targets: how many, and the median
    and 90 % quantile of their errors [cm].
    """
    rows = []
    for low, high in pairwise(EDGES_M):
        some = 100 * errors[(errors[:, 0] >= low) & (errors[:, 0] < high)]
        if len(some):
            quantiles = np.quantile(some, (0.5, 0.9), axis=0)
            rows.append(
                {
                    "from_cm": 100 * low,
                    "to_cm": 100 * high if np.isfinite(high) else None,
                    "images": len(some),
                    "along_cm": quantiles[:, 1].tolist(),
                    "across_cm": quantiles[:, 2].tolist(),
                }
            )
    return rows


if __name__ == "__main__":
    main()
