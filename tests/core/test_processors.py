"""The same bytes on every x86-64: nothing that decides an episode depends on the instructions that
a processor has.

OpenBLAS and NumPy have variants of their functions for each generation of processors, which round
differently, and can be told not to use them.
"""

import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.tools import python
from tests.world.playing import digest

HERE = [name for name in __cpu_dispatch__ if __cpu_features__[name]]
LEAST = {"NPY_DISABLE_CPU_FEATURES": " ".join(HERE), "OPENBLAS_CORETYPE": "Prescott"}
PROCESSORS = {
    "no FMA in the C library": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"},
    "the least": LEAST,
}
FUNCTIONS = """
import hashlib
import numpy as np
from dynahoi_lerobot.core.numerics import *
a, b = np.random.default_rng(0).uniform(-9, 9, (2, 30_000))
results = [sin(a), cos(a), tan(a), arcsin(a / 9), arctan2(a, b), cbrt(a),
           product(a.reshape(-1, 30), b.reshape(30, -1))]
print(hashlib.sha256(b"".join(result.tobytes() for result in results)).hexdigest())
"""


def played() -> list[str]:
    """What the expert does in its first episode of each kind, and in some behind a screen and with
    contacts.
    """
    lines = []
    test = Recipe.of(split="test", image_size=0)
    for recipe, count in (
        (test, 22),
        (changed(test, {"protocol": "occluded"}), 4),
        (changed(test, {"capture": "contact"}), 4),
    ):
        specs = sample_specs(recipe, range(count), threads=1)
        for episode in evaluate(
            WorldBatch(recipe.rules, 11, threads=1),
            EXPERTS[recipe.rules.capture_rule.expert](),
            specs,
        ):
            spec = specs[episode.meta.seed]
            lines.append(
                f"{recipe.rules.capture} {recipe.rules.protocol} {spec.motion.name} "
                f"{spec.appearance} {digest(episode)}"
            )
    return lines


def test_functions_do_not_depend_on_the_processor() -> None:
    printed = {
        name: python("-c", FUNCTIONS, **environment) for name, environment in PROCESSORS.items()
    }
    assert set(printed.values()) == {python("-c", FUNCTIONS)}, printed


@pytest.mark.slow
def test_episodes_do_not_depend_on_the_processor() -> None:
    reference = played()
    assert len(reference) == 30
    program = "from tests.core.test_processors import played; print(*played(), sep='\\n')"
    assert python("-c", program, **LEAST).splitlines() == reference
