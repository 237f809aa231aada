"""What several core tests need and is expensive: built once per worker, and never changed by a test."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.dataset.episodes import write
from tests.menagerie import gather_menagerie
from tests.world.playing import SMALL

os.environ.setdefault("OMP_NUM_THREADS", "1")  # each worker has a core; more threads of torch fight over them


@pytest.fixture(scope="session", autouse=True)
def menagerie(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Every test finds the robot hands of MuJoCo Menagerie, real ones where this machine has them, else stand-ins."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENAGERIE_ROOT", str(gather_menagerie(tmp_path_factory.mktemp("menagerie"))))
        yield


@pytest.fixture(scope="session")
def specs() -> list[EpisodeSpec]:
    """The first 44 episodes of ``test``: every kind twice."""
    return sample_specs(SMALL, range(44))


@pytest.fixture(scope="session")
def expert_episodes(specs: list[EpisodeSpec]) -> list[Episode]:
    """The expert's evaluation on ``specs``, in their order, without images."""
    episodes = evaluate(WorldBatch(SMALL, 22, threads=1), EXPERTS["intercept"](), specs)
    return sorted(episodes, key=lambda episode: episode.meta.seed)


@pytest.fixture(scope="session")
def actor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a tiny ObAct for images of 32 pixels, which has learned nothing."""
    from tests.checkpoints import tiny_obact  # which takes long to import

    return tiny_obact(tmp_path_factory.mktemp("actor") / "checkpoint")


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six synthetic episodes with video on disk."""
    return write(tmp_path_factory.mktemp("ours") / "dataset", range(6))
