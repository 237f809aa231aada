"""Stronger randomization of appearance, each by a name that a recipe may list; it changes nothing
but images.

Each draws from random numbers of its own, seeded with the episode, so the episode keeps its motion,
its instruction and what the other randomizations drew. They address the first limitation that the
paper names, that its scenes look alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dynahoi_lerobot.core.conventions import APPEARANCE_STREAM
from dynahoi_lerobot.core.numerics import cos, sin
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.scene.appearance import Appearance, Solid, hsv
from dynahoi_lerobot.scene.model import DISTRACTORS

BEHIND_M = 0.35
"""Distractors stand at least this far behind the farthest point of the target's path, so that they
hide nothing."""


def randomize_appearance(spec: EpisodeSpec, names: Sequence[str]) -> EpisodeSpec:
    """Return the episode with the appearance that each of ``names`` in ``RANDOMIZATIONS`` draws for
    its seed.
    """
    for number, (name, draw) in enumerate(RANDOMIZATIONS.items()):
        if name in names:
            rng = np.random.default_rng([APPEARANCE_STREAM, number, spec.seed])
            spec = replace(spec, appearance=draw(spec, rng))
    return spec


def _materials(spec: EpisodeSpec, rng: np.random.Generator) -> Appearance:
    """Any color on target, surroundings and hand, from pale to saturated."""
    return replace(
        spec.appearance,
        target_rgb=hsv(rng.random(), rng.uniform(0.0, 1.0), rng.uniform(0.25, 1.0)),
        floor_rgb=hsv(rng.random(), rng.uniform(0.0, 0.9), rng.uniform(0.2, 1.0)),
        wall_rgb=hsv(rng.random(), rng.uniform(0.0, 0.9), rng.uniform(0.2, 1.0)),
        box_rgb=hsv(rng.random(), rng.uniform(0.0, 0.9), rng.uniform(0.2, 1.0)),
        skin_rgb=hsv(rng.random(), rng.uniform(0.0, 0.6), rng.uniform(0.15, 1.0)),
    )


def _lights(spec: EpisodeSpec, rng: np.random.Generator) -> Appearance:
    """Light from dim to glaring, slightly colored, from any direction above."""
    angle = rng.uniform(0, 2 * np.pi)
    slant = rng.uniform(0.0, 1.5)
    return replace(
        spec.appearance,
        light_level=rng.uniform(0.15, 1.1),
        light_rgb=hsv(rng.random(), rng.uniform(0.0, 0.35), 1.0),
        light_dir=(float(slant * cos(angle)), float(slant * sin(angle)), -1.0),
    )


def _specular(spec: EpisodeSpec, rng: np.random.Generator) -> Appearance:
    """Surfaces from dull to polished."""
    return replace(spec.appearance, gloss=rng.uniform(0.0, 0.9))


def _transparency(spec: EpisodeSpec, rng: np.random.Generator) -> Appearance:
    """A target from opaque to two thirds transparent."""
    return replace(spec.appearance, target_alpha=rng.uniform(0.35, 1.0))


def _distractors(spec: EpisodeSpec, rng: np.random.Generator) -> Appearance:
    """One to four colored solids that stand or float behind the target's path and do not move."""
    begin = max(float(spec.target_path_w[:, 0].max()), float(spec.home_pos_w[0])) + BEHIND_M
    chosen = rng.permutation(list(DISTRACTORS))[: rng.integers(1, len(DISTRACTORS) + 1)]
    things = [
        Solid(
            shape=str(shape),
            half_size=tuple(rng.uniform(0.03, 0.16, 3).tolist()),
            pos_w=(
                begin + rng.uniform(0.0, 1.5),
                float(spec.home_pos_w[1]) + rng.uniform(-1.0, 1.0),
                max(float(spec.home_pos_w[2]) + rng.uniform(-0.6, 0.5), 0.2),
            ),
            rgb=hsv(rng.random(), rng.uniform(0.6, 1.0), rng.uniform(0.6, 1.0)),
        )
        for shape in chosen
    ]
    return replace(spec.appearance, distractors=tuple(things))


RANDOMIZATIONS: dict[str, Callable[[EpisodeSpec, np.random.Generator], Appearance]] = {
    "materials": _materials,
    "lights": _lights,
    "specular": _specular,
    "transparency": _transparency,
    "distractors": _distractors,
}
"""By the name that a recipe lists. The order decides the random numbers: append, do not insert."""
