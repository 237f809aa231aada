"""The same bytes on every x86-64: nothing that decides an episode depends on the instructions that a processor has.

OpenBLAS and NumPy have variants of their functions for each generation of processors, which round differently, and can
be told not to use them.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

HERE = [name for name in __cpu_dispatch__ if __cpu_features__[name]]
PROCESSORS = {
    "all that it has": {},
    "the least of all": {"OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": " ".join(HERE)},
}
PLAY = """
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import digest

test = Recipe(split="test", image_size=0)
for recipe, count in ((test, 22), (test.changed(protocol="occluded"), 6), (test.changed(capture="contact"), 8)):
    specs = sample_specs(recipe, range(count), threads=1)
    for episode in evaluate(WorldBatch(recipe, 11, threads=1), EXPERTS[recipe.expert](), specs):
        spec = specs[episode.meta.seed]
        print(recipe.capture, recipe.protocol, spec.motion.name, spec.appearance, digest(episode))
"""


@pytest.mark.slow
def test_episodes_do_not_depend_on_the_processor() -> None:
    """The expert's first episode of each kind, and some behind a screen and with contacts."""
    played = {
        name: subprocess.run(
            [sys.executable, "-c", PLAY], env=os.environ | changes, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for name, changes in PROCESSORS.items()
    }
    reference = played["all that it has"]
    assert len(reference) == 36
    for name, episodes in played.items():
        assert episodes == reference, name
