"""The same bytes on every processor of a kind: nothing that decides an episode is left to BLAS.

OpenBLAS rounds differently with the instructions of each generation of processors, and can be told which to use.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PLAY = """
from dynahoi_lerobot.doctor.reference import EXPERTS, RECIPE, WorldBatch, _digest, evaluate, sample_specs

specs = sample_specs(RECIPE, range(44), threads=1)
played = evaluate(WorldBatch(RECIPE, 22), EXPERTS[RECIPE.expert](), specs)
for episode in sorted(played, key=lambda episode: episode.meta.seed):
    print(episode.meta.motion, _digest([episode.state, episode.action, episode.target_pose]))
"""


def played_with(kernels: str) -> list[str]:
    """Return the digests of the expert's first two episodes of each kind, played with OpenBLAS's ``kernels``."""
    environment = {**os.environ, "OPENBLAS_CORETYPE": kernels}
    done = subprocess.run([sys.executable, "-c", PLAY], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.mark.slow
def test_episodes_do_not_depend_on_the_kernels_of_blas() -> None:
    newer, older = played_with("Haswell"), played_with("Sandybridge")
    assert len(newer) == 44
    assert newer == older
