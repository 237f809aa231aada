"""EpisodeSpecs from seeds: random numbers enter the project here and nowhere else."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynahoi_lerobot.appearance import Appearance
from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.motions import MOTIONS, Draw, Motion, PhysicalMotion
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from dynahoi_lerobot.sampling.placement import find_home, in_arena
from dynahoi_lerobot.sampling.randomization import randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.timing import Timing, draw_timing
from dynahoi_lerobot.world.untouched_path import roll_ahead

MAX_ROUNDS = 400
PATIENCE = 30
"""Rounds after which a draft that never fitted gets another duration and travel."""
MIN_OBSERVED_S = 0.25
"""A target that is let go must be seen moving for this long before control starts."""
MAX_SPIN_RAD_S = 2.0
REVEALING = "Catch the {object} that is {phrase}."
NEUTRAL = "Catch the moving {object}."


@dataclass
class _Draft:
    """An episode under construction: what is fixed by its seed, and the current attempt at a motion."""

    seed: int
    rng: np.random.Generator
    kind: type[Motion]
    timing: Timing
    motion: Motion | None = None
    target: TargetObject | None = None


def sample_specs(recipe: Recipe, seeds: Sequence[int], *, threads: int = 1) -> list[EpisodeSpec]:
    """Return the episodes of ``seeds``, in order.

    Each is a function of (recipe, seed) alone: motions, objects and homes are redrawn from the seed's own stream until
    the target can be met and seen, whatever else is sampled in the same call. Kinds take turns:
    ``motion_names[seed % len]``.

    Raises:
        ValueError: for a negative seed, or if a motion never fits (the message names motion and seed).
    """
    drafts = [_start(recipe, seed) for seed in seeds]
    done: dict[int, EpisodeSpec] = {}
    pending = list(range(len(drafts)))
    for attempt in range(1, MAX_ROUNDS + 1):
        pending = _round(recipe, drafts, pending, done, threads)
        if not pending:
            return [done[i] for i in range(len(drafts))]
        if attempt % PATIENCE == 0:
            for i in pending:
                drafts[i].timing = _timing(recipe, drafts[i].kind, drafts[i].rng)
    stuck = drafts[pending[0]]
    raise ValueError(f"motion {stuck.kind.name!r} never came into reach and view for seed {stuck.seed}")


def sample_spec(recipe: Recipe, seed: int) -> EpisodeSpec:
    """Return the episode of one seed."""
    return sample_specs(recipe, [seed])[0]


def _start(recipe: Recipe, seed: int) -> _Draft:
    if seed < 0:
        raise ValueError(f"seeds must not be negative, got {seed}")
    rng = np.random.default_rng([zlib.crc32(recipe.split.encode()), seed])
    names = recipe.motion_names
    kind = MOTIONS[names[seed % len(names)]]
    return _Draft(seed, rng, kind, _timing(recipe, kind, rng))


def _timing(recipe: Recipe, kind: type[Motion], rng: np.random.Generator) -> Timing:
    """Draw a timing, and leave the capture rule the time it needs after the intercept."""
    timing = draw_timing(kind.name, recipe.protocol, rng)
    meeting, hold = timing.window_frames + timing.approach_frames, CAPTURES[recipe.capture].hold_frames
    return replace(timing, length_frames=max(timing.length_frames, meeting + 1 + hold))


def _round(
    recipe: Recipe, drafts: list[_Draft], pending: list[int], done: dict[int, EpisodeSpec], threads: int
) -> list[int]:
    """Draw a motion for every pending draft, roll them ahead together, keep those that fit; return the rest."""
    drawn = [i for i in pending if _draw_motion(recipe, drafts[i])]
    paths = _roll(recipe, [drafts[i] for i in drawn], _until_intercept, threads)
    homes = {i: find_home(p, drafts[i].timing, drafts[i].rng) for i, p in zip(drawn, paths, strict=True)}
    found = [i for i in drawn if homes[i] is not None]
    for i, path in zip(found, _roll(recipe, [drafts[i] for i in found], _horizon, threads), strict=True):
        home = homes[i]
        if in_arena(path) and home is not None:
            done[i] = _finish(recipe, drafts[i], path, home)
    return [i for i in pending if i not in done]


def _roll(recipe: Recipe, drafts: list[_Draft], frames: Callable[[Timing], int], threads: int) -> list[np.ndarray]:
    motions, targets = [d.motion for d in drafts], [d.target for d in drafts]
    lengths = [frames(d.timing) for d in drafts]
    return roll_ahead(motions, targets, lengths, hand=recipe.hand, threads=threads)  # type: ignore[arg-type]


def _until_intercept(timing: Timing) -> int:
    return timing.window_frames + timing.approach_frames + 1


def _horizon(timing: Timing) -> int:
    return timing.window_frames + timing.length_frames + 1


def _draw_motion(recipe: Recipe, draft: _Draft) -> bool:
    """Draw object and motion; tell whether enough of the motion would be seen."""
    timing, rng = draft.timing, draft.rng
    allowed = [name for name in recipe.object_names if name in draft.kind.objects()]
    if not allowed:
        raise ValueError(f"motion {draft.kind.name!r} takes none of the objects {', '.join(recipe.object_names)}")
    name = str(rng.choice(allowed))
    draft.target = OBJECTS[name].sample(name, rng)
    window_s = timing.window_frames * CONTROL_DT
    draw = Draw(
        rng=rng,
        target=draft.target,
        window_s=window_s,
        intercept_s=window_s + timing.approach_frames * CONTROL_DT,
        horizon_s=_horizon(timing) * CONTROL_DT,
        tempo=recipe.tempo,
    )
    draft.motion = draft.kind.sample(draw)
    if not isinstance(draft.motion, PhysicalMotion):
        return True
    return draft.motion.launch(draft.target).release_s <= max(0.0, window_s - MIN_OBSERVED_S)


def _finish(recipe: Recipe, draft: _Draft, path: np.ndarray, home: np.ndarray) -> EpisodeSpec:
    timing, rng = draft.timing, draft.rng
    assert draft.motion is not None
    assert draft.target is not None
    intercept = timing.window_frames + timing.approach_frames
    spec = EpisodeSpec(
        seed=draft.seed,
        split=recipe.split,
        motion=draft.motion,
        target=draft.target,
        appearance=Appearance.sample(rng),
        task=_instruction(recipe.instructions, draft.motion, draft.target.name, rng),
        protocol=recipe.protocol,
        hand=recipe.hand,
        window_frames=timing.window_frames,
        length_frames=timing.length_frames,
        home_pos_w=home,
        intercept_frame=intercept,
        intercept_pos_w=path[intercept],
        yaw_rad=float(rng.uniform(0, 2 * np.pi)),
        spin_rad_s=float(rng.uniform(-MAX_SPIN_RAD_S, MAX_SPIN_RAD_S)),
        oracle_path=path,
        fingerprint=recipe.fingerprint(),
    )
    return randomize_appearance(spec, recipe.appearance)


def _instruction(style: str, motion: Motion, object_name: str, rng: np.random.Generator) -> str:
    reveals = rng.random() < 0.5 if style == "mixed" else style == "reveal"
    template = REVEALING if reveals else NEUTRAL
    return template.format(object=object_name, phrase=motion.phrase)
