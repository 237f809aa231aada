"""How often the expert of the contact track holds the target at its first attempt, per kind and object, with films.

python benchmarks/contact_expert.py [--episodes 1000] [--gifs docs/contact] [--json FILE]
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.evaluate.gif import phases_of, write_gif
from dynahoi_lerobot.evaluate.intervals import wilson
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import make_batch, play
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

HELD_KINDS, FAILURES = ("lob", "line_then_arc"), 2
"""Kinds of the films of catches, and the number of films of failures."""
SHOWN_FRAMES_AFTER = 24
SHOWN_FRAMES_BEFORE = 4
SLOW_FPS = 5  # a quarter of the true speed


def main() -> None:
    parser = benchmark_parser(__doc__, episodes=2, image_size=32, gifs=Path("films"))
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--gifs", type=Path, help="folder for films of catches and failures")
    parser.add_argument("--image-size", type=int, default=160, help="of the films [px]")
    args = parser.parse_args()
    recipe = Recipe(split="test", capture="contact", image_size=args.image_size)
    specs = sample_specs(recipe, range(args.episodes), threads=0)
    episodes = [e for _, e in play(make_batch(recipe, 32), EXPERTS[recipe.expert](), jobs_of(specs))]
    tables = {noun: table(grouped(episodes, noun)) for noun in ("motion", "object", "stage")}
    tables["all"] = table({"all": [e.success for e in episodes]})
    for noun, rows in tables.items():
        print(f"\n{noun:20s} {'S_hold %':>22s} {'n':>5s}")
        for name, line in rows.items():
            print(f"{name:20s} {line['value']:6.1f} [{line['low']:5.1f}, {line['high']:5.1f}] {line['n']:5d}")
    write_numbers(args, S_hold_percent=tables)
    if args.gifs:
        held = first_of_each_kind(e for e in episodes if e.success and e.meta.motion in HELD_KINDS)
        films(recipe, held, args.gifs, "held")
        films(recipe, first_of_each_kind(e for e in episodes if not e.success)[:FAILURES], args.gifs, "failed")


def jobs_of(specs: list) -> list[Job]:
    return [Job.evaluation(i, spec) for i, spec in enumerate(specs)]


def grouped(episodes: list[Episode], noun: str) -> dict[str, list[bool]]:
    groups: dict[str, list[bool]] = defaultdict(list)
    for episode in episodes:
        groups[episode.stage if noun == "stage" else getattr(episode.meta, noun)].append(episode.success)
    return groups


def table(groups: dict[str, list[bool]]) -> dict[str, dict[str, Any]]:
    """Return the share of successes [%], its 95 % interval and the number of episodes of each group, by name."""
    rows = {}
    for name, outcomes in sorted(groups.items()):
        low, high = wilson(sum(outcomes), len(outcomes))
        share = sum(outcomes) / len(outcomes)
        rows[name] = {"value": 100 * share, "low": 100 * low, "high": 100 * high, "n": len(outcomes)}
    return rows


def first_of_each_kind(episodes: Iterable[Episode]) -> list[Episode]:
    """Return the episode of the least seed of each kind of motion, by seed."""
    ordered = sorted(episodes, key=lambda episode: -episode.meta.seed)
    return sorted({e.meta.motion: e for e in ordered}.values(), key=lambda episode: episode.meta.seed)


def films(recipe: Recipe, episodes: list[Episode], folder: Path, word: str) -> None:
    """Play episodes once more and film them, in slow motion around the catch."""
    folder.mkdir(parents=True, exist_ok=True)
    specs = sample_specs(recipe, [e.meta.seed for e in episodes])
    for _, episode in play(make_batch(recipe, 1), EXPERTS[recipe.expert](), jobs_of(specs), images=True):
        start = max(0, episode.meta.window_frames - SHOWN_FRAMES_BEFORE)
        shown = slice(start, min(len(episode), episode.meta.intercept_frame + SHOWN_FRAMES_AFTER))
        frames, caption = episode.images["ego"][shown], f"{episode.meta.motion}: {episode.stage}"
        path = folder / f"{word}_{episode.meta.motion}_{episode.meta.seed}.gif"
        write_gif(path, frames, caption=caption, phases=phases_of(episode)[shown], fps=SLOW_FPS)
        print(path)


if __name__ == "__main__":
    main()
