"""How often the expert of the contact track holds the target at its first attempt, per kind and object, with films.

python benchmarks/contact_expert.py --episodes 1000 --gifs docs/contact
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.evaluate.gif import phases_of, write_gif
from dynahoi_lerobot.evaluate.intervals import wilson
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import make_batch, play
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

FILMS_EACH = 3
SHOWN_FRAMES_AFTER = 24
SHOWN_FRAMES_BEFORE = 4
SLOW_FPS = 5  # a quarter of the true speed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--gifs", type=Path, help="folder for films of catches and failures")
    args = parser.parse_args()
    recipe = Recipe(split="test", capture="contact", image_size=128)
    specs = sample_specs(recipe, range(args.episodes), threads=0)
    episodes = [e for _, e in play(make_batch(recipe, 32), EXPERTS[recipe.expert](), jobs_of(specs))]
    for noun in ("motion", "object", "stage"):
        print(f"\n{noun:20s} {'S_hold %':>22s} {'n':>5s}")
        for name, outcomes in sorted(grouped(episodes, noun).items()):
            print(row(name, outcomes))
    print("\n" + row("all", [e.success for e in episodes]))
    if args.gifs:
        films(recipe, [e for e in episodes if e.success], args.gifs, "held")
        films(recipe, [e for e in episodes if not e.success], args.gifs, "failed")


def jobs_of(specs: list) -> list[Job]:
    return [Job.evaluation(i, spec) for i, spec in enumerate(specs)]


def grouped(episodes: list[Episode], noun: str) -> dict[str, list[bool]]:
    groups: dict[str, list[bool]] = defaultdict(list)
    for episode in episodes:
        groups[episode.stage if noun == "stage" else getattr(episode.meta, noun)].append(episode.success)
    return groups


def row(name: str, outcomes: list[bool]) -> str:
    low, high = wilson(sum(outcomes), len(outcomes))
    share = 100 * sum(outcomes) / len(outcomes)
    return f"{name:20s} {share:6.1f} [{100 * low:5.1f}, {100 * high:5.1f}] {len(outcomes):5d}"


def films(recipe: Recipe, episodes: list[Episode], folder: Path, word: str) -> None:
    """Film the first episodes of distinct kinds once more, in slow motion around the catch."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen = list({e.meta.motion: e for e in sorted(episodes, key=lambda e: -e.meta.seed)}.values())[-FILMS_EACH:]
    specs = sample_specs(recipe, [e.meta.seed for e in chosen])
    for _, episode in play(make_batch(recipe, 1), EXPERTS[recipe.expert](), jobs_of(specs), images=True):
        start = max(0, episode.meta.window_frames - SHOWN_FRAMES_BEFORE)
        shown = slice(start, min(len(episode), episode.meta.intercept_frame + SHOWN_FRAMES_AFTER))
        frames, caption = episode.images["ego"][shown], f"{episode.meta.motion}, {episode.meta.object}: {episode.stage}"
        path = folder / f"{word}_{episode.meta.motion}_{episode.meta.seed}.gif"
        write_gif(path, frames, caption=caption, phases=phases_of(episode)[shown], fps=SLOW_FPS)
        print(path)


if __name__ == "__main__":
    main()
