"""Third claim: what an episode is follows from its seed, without playing it."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.core.numerics import TOLERANCE
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.rollout.recorder import Job, episode_constants, episode_meta
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import REDRAW_STRIDE
from dynahoi_lerobot.world.batch import WorldBatch

AT_ONCE = 64
PLAYED = ("first_plan",)
"""Constants of an episode that depend on who plays it."""


def seed_problems(
    store: Store, manifest: Manifest, recipe: Recipe | None, note: Callable[[str], object]
) -> Iterator[str]:
    """Yield seeds that are not the plan's, and facts and constants of episodes that their seeds do not give.

    ``note`` is told in a sentence why that could not be checked, if so.
    """
    plan, seeds = manifest.provenance, [row["seed"] for row in store.rows]
    if recipe is None:
        return note("no recipe is known, so nothing was compared with the seeds")
    kept = plan.get("kept", range(plan["episodes"]))
    if sorted(seed % REDRAW_STRIDE for seed in seeds) != [plan["seed"] + slot for slot in kept]:
        yield f"the seeds are not those of {len(kept)} episodes from seed {plan['seed']} on"
    if plan["code"] != code_fingerprint():
        return note(f"made by other code ({plan['code']}), so nothing else was compared with the seeds")
    if recipe.salt:
        return note("its episodes are hidden behind a salt, so nothing else was compared with the seeds")
    batch, episodes = WorldBatch(recipe, 1), store.stored_episodes()
    for first in range(0, len(seeds), AT_ONCE):
        for offset, spec in enumerate(sample_specs(recipe, seeds[first : first + AT_ONCE], threads=0)):
            row, table = next(episodes)
            stored = store.as_episode(row, table, images=False)
            job = Job(0, spec, 0, stored.meta.attempts)
            meta = episode_meta(job, recipe.capture, recipe.control_class, recipe.actor or recipe.expert)
            constants = episode_constants(batch, spec, None)
            wanted = {name: value for name, value in constants.items() if name not in PLAYED}
            problems = differences(vars(meta) | wanted, vars(stored.meta) | vars(stored))
            yield from (f"episode {first + offset} has by its seed {problem}" for problem in problems)


def differences(made: Mapping[str, Any], stored: Mapping[str, Any]) -> Iterator[str]:
    """Yield what was made otherwise than it is stored: text and whole numbers exactly, others up to ``TOLERANCE``."""
    for name, one in made.items():
        other = stored[name]
        if one is None or other is None or isinstance(one, str | int):
            if type(one) is not type(other) or one != other:
                yield f"{name} {one!r:.80}; stored is {other!r:.80}"
            continue
        values = np.asarray(one, FEATURES[name].dtype)
        if values.shape != np.shape(other):
            yield f"{name} of shape {values.shape}; stored is {np.shape(other)}"
        elif not (apart := np.abs(values.astype(float) - other)).max(initial=0.0) <= TOLERANCE:
            first = int((~(apart.reshape(len(apart), -1).max(axis=1) <= TOLERANCE)).argmax()) if apart.ndim else 0
            yield f"another {name} from row {first} on, up to {float(apart.max()):.2g} apart"
