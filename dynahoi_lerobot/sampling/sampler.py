"""EpisodeSpecs from a recipe and seeds: candidates are redrawn until the hand can observe and reach the target."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.sampling.candidate import Candidate
from dynahoi_lerobot.sampling.placement import choose_home, find_homes, in_arena
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.untouched_path import roll_ahead

MAX_ATTEMPTS = 400
ATTEMPTS_PER_TIMING = 30
"""After so many motions that did not fit, duration and travel are drawn again as well."""


def sample_specs(recipe: Recipe, seeds: Sequence[int], *, threads: int = 1) -> list[EpisodeSpec]:
    """Return the episodes of ``seeds``, in order.

    Each is a function of (recipe, seed) alone, whatever else is sampled in the same call: its motion, object and home
    are redrawn from the seed's own random numbers until the target can be observed and reached. Kinds of motion take
    turns: seed s has ``recipe.motion_names[s % len(recipe.motion_names)]``.

    Args:
        recipe: what to draw from.
        seeds: of the episodes, not negative.
        threads: for rolling targets ahead; the result does not depend on it.

    Raises:
        ValueError: for a negative seed, or if no motion ever fits (the message names motion and seed).
    """
    pending = {i: Candidate.start(recipe, seed) for i, seed in enumerate(seeds)}
    specs: dict[int, EpisodeSpec] = {}
    for attempt in range(1, MAX_ATTEMPTS + 1):
        specs |= _attempt(recipe, pending, threads)
        pending = {i: candidate for i, candidate in pending.items() if i not in specs}
        if not pending:
            return [specs[i] for i in range(len(seeds))]
        if attempt % ATTEMPTS_PER_TIMING == 0:
            for candidate in pending.values():
                candidate.draw_timing()
    failed = next(iter(pending.values()))
    raise ValueError(f"motion {failed.kind.name!r} never came into reach and view for seed {failed.seed}")


def sample_spec(recipe: Recipe, seed: int) -> EpisodeSpec:
    """Return the episode of one seed; see ``sample_specs``."""
    return sample_specs(recipe, [seed])[0]


def _attempt(recipe: Recipe, pending: dict[int, Candidate], threads: int) -> dict[int, EpisodeSpec]:
    """Draw a motion for every pending candidate, roll all targets ahead together; return the episodes that fit."""
    drawn = {i: candidate for i, candidate in pending.items() if candidate.draw_motion()}
    paths = _roll_ahead(recipe, drawn, {i: c.timing.intercept_frame + 1 for i, c in drawn.items()}, threads)
    homes = {i: find_homes(paths[i], c.timing, c.fixtures, c.rng) for i, c in drawn.items()}
    reached = {i: c for i, c in drawn.items() if len(homes[i])}
    paths = _roll_ahead(recipe, reached, {i: c.timing.path_frames for i, c in reached.items()}, threads)
    return {
        i: spec
        for i, candidate in reached.items()
        if in_arena(paths[i])
        and (home := choose_home(paths[i], candidate.timing, homes[i])) is not None
        and (spec := candidate.accept(paths[i], home)) is not None
    }


def _roll_ahead(
    recipe: Recipe, candidates: dict[int, Candidate], frames: dict[int, int], threads: int
) -> dict[int, np.ndarray]:
    """(F, 3) path [m], world, of each candidate's untouched target over its number of frames."""
    motions, targets = [c.motion for c in candidates.values()], [c.target for c in candidates.values()]
    paths = roll_ahead(motions, targets, list(frames.values()), hand=recipe.hand, threads=threads)
    return dict(zip(candidates, paths, strict=True))
