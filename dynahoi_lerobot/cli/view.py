"""``dynahoi view``: watch one episode, played anew, from a dataset or from results, as GIF, MP4 or a page with both."""

from __future__ import annotations

import argparse
import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import draccus
import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.evaluate.command import make_actor
from dynahoi_lerobot.evaluate.gif import phases_of, write_gif
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.renderers.views import VIEWS
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.rollout.replay import replay
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import kind_seed, seed_stream

MIN_WIDTH_PX = 384
PAGE = """<!doctype html><meta charset="utf-8"><title>{caption}</title>
<style>body{{font:16px system-ui;background:#111;color:#ddd;text-align:center}}img{{image-rendering:pixelated}}</style>
<p>{caption}</p><img alt="{caption}" src="data:image/gif;base64,{data}">"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi view``."""
    parser.add_argument("--motion", help="kind of motion to play")
    parser.add_argument(
        "--seed", type=int, default=0, help="number of the episode within split and kind; with --results, its seed"
    )
    parser.add_argument("--split", default="test", help="seed stream")
    parser.add_argument("--policy", default="expert", help="who moves the hand: a checkpoint folder or an expert")
    parser.add_argument("--capture", default="attach", help="capture rule")
    parser.add_argument("--dataset", type=Path, help="show an episode of this dataset instead")
    parser.add_argument("--episode", type=int, default=0, help="its index in the dataset")
    parser.add_argument("--results", type=Path, help="play an evaluated episode of this result folder again")
    parser.add_argument("--image-size", type=int, help="side of the images [px]")
    parser.add_argument("--view", default="ego", choices=VIEWS, help="what is shown of it, from which camera")
    parser.add_argument("--out", type=Path, default=Path("episode.gif"), help="a .gif, .mp4 or .html file")


def run(args: argparse.Namespace) -> int:
    """Write the file; return the exit code.

    Raises:
        ValueError: for an unknown suffix, motion or episode.
    """
    if args.out.suffix not in WRITERS:
        raise ValueError(f"cannot write {args.out.suffix or 'a file without suffix'!r}; use {', '.join(WRITERS)}")
    source = _from_dataset if args.dataset else _replayed if args.results else _played
    frames, caption, phases = source(args)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    WRITERS[args.out.suffix](args.out, frames, caption, phases)
    print(f"{caption}: {args.out}")
    return 0


Shown = tuple[np.ndarray, str, list[str]]


def _played(args: argparse.Namespace) -> Shown:
    """Play an episode; frames (T, H, W, 3), a caption, and the phase of every frame."""
    if args.motion is None:
        raise ValueError("say what to watch: --motion KIND, --dataset DIR --episode I, or --results DIR --seed S")
    actor = make_actor(args.policy, args.capture)
    size = args.image_size or actor.image_size or 256
    views = {*actor.views, args.view} - {"ego"}
    recipe = Recipe(split=seed_stream(args.split), image_size=size, views=tuple(sorted(views)), capture=args.capture)
    spec = sample_specs(recipe, [kind_seed(recipe, args.split, args.motion, args.seed)])[0]
    return _shown(next(evaluate(make_batch(recipe, 1), actor, [spec], images=True)), args.view)


def _replayed(args: argparse.Namespace) -> Shown:
    """Play the commands of an evaluated episode again, from its seed; at any image size."""
    results = read_results(args.results)
    seeds = [row["seed"] for row in results.rows]
    if args.seed not in seeds:
        raise ValueError(f"{args.results} has no episode with seed {args.seed}; it has {min(seeds)} to {max(seeds)}")
    if "recipe" not in results.info.extra:
        raise ValueError(f"{args.results} does not say what was played; evaluate again with this version")
    recipe = draccus.decode(Recipe, results.info.extra["recipe"])
    if recipe.fingerprint() != results.info.fingerprint:
        print("these results are of other code: the replay may differ from what was graded")
    index = seeds.index(args.seed)
    views = () if args.view == "ego" else (args.view,)
    shown, attempt = replace(recipe, image_size=args.image_size or 256, views=views), results.rows[index]["attempts"]
    return _shown(replay(shown, args.seed, results.actions[index], attempt=attempt), args.view, results.info.policy)


def _shown(episode: Episode, view: str, agent: str = "") -> Shown:
    meta = episode.meta
    return episode.images[view], f"{agent or meta.agent}: {meta.task} {episode.stage}", phases_of(episode)


def _from_dataset(args: argparse.Namespace) -> Shown:
    """Read an episode of a dataset with LeRobot."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from dynahoi_lerobot.features import FEATURES, IMAGE_PREFIX

    dataset = LeRobotDataset(args.dataset.name, root=args.dataset)
    if not 0 <= args.episode < dataset.num_episodes:
        raise ValueError(f"--episode must be 0 to {dataset.num_episodes - 1}, got {args.episode}")
    if (key := IMAGE_PREFIX + args.view) not in dataset.meta.camera_keys:
        raise ValueError(f"{args.dataset} has no view {args.view!r}; it has {', '.join(dataset.meta.camera_keys)}")
    table: Any = dataset.meta.episodes
    first, last = (int(table[args.episode][key]) for key in ("dataset_from_index", "dataset_to_index"))
    items: list[Any] = [dataset[i] for i in range(first, last)]
    frames = np.stack([(item[key].numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8) for item in items])
    phases = [_phase(bool(item["localized"].item()), float(item[FEATURES["phase"].key].item())) for item in items]
    return frames, str(items[0]["task"]), phases


def _phase(localized: bool, acting: float) -> str:
    return "localized" if localized else "acting" if acting else "observing"


def _gif(path: Path, frames: np.ndarray, caption: str, phases: list[str]) -> None:
    write_gif(path, frames, caption=caption, phases=phases, scale=-(-MIN_WIDTH_PX // frames.shape[2]))


def _html(path: Path, frames: np.ndarray, caption: str, phases: list[str]) -> None:
    gif = path.with_suffix(".gif")
    _gif(gif, frames, caption, phases)
    path.write_text(PAGE.format(caption=caption, data=base64.b64encode(gif.read_bytes()).decode()))
    gif.unlink()


def _mp4(path: Path, frames: np.ndarray, caption: str, phases: list[str]) -> None:
    import av

    del caption, phases  # a film has no room for them
    with av.open(str(path), "w") as film:
        stream = film.add_stream("h264", rate=CONTROL_HZ)
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        for frame in frames:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        film.mux(stream.encode())


WRITERS = {".gif": _gif, ".mp4": _mp4, ".html": _html}
