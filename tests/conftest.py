"""What several tests need and is expensive: made once, by the first worker that needs it, and
changed by no test.
"""

import fcntl
import functools
import os
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.sampling.sampler import sample_specs
from tests.dataset.episodes import write
from tests.menagerie import gather_menagerie
from tests.world.playing import SMALL, played

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # each worker has a core; more threads of torch fight over them


@pytest.fixture(scope="session", autouse=True)
def menagerie(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Every test finds the robot hands of MuJoCo Menagerie, real ones where this machine has them,
    else stand-ins.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENAGERIE_ROOT", str(gather_menagerie(tmp_path_factory.mktemp("menagerie"))))
        yield


Once = Callable[[str, Callable[[Path], Any]], Any]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return what a function makes of a new folder; if a worker has made what has this name, return
    that.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def once(name: str, make: Callable[[Path], Any]) -> Any:
        result = shared / f"{name}.pickle"
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not result.exists():
                result.write_bytes(pickle.dumps(make(shared / name)))
        return pickle.loads(result.read_bytes())

    return once


@pytest.fixture(scope="session")
def specs(once: Once) -> list[EpisodeSpec]:
    """The first 44 episodes of ``test``: every kind twice."""
    return once("specs", lambda _: sample_specs(SMALL, range(44)))


@pytest.fixture(scope="session")
def in_class(specs: list[EpisodeSpec], once: Once) -> Callable[[str], list[Episode]]:
    """The expert's evaluation in a control class, on ``specs`` or the first half of them, in order,
    without images.
    """

    @functools.cache
    def in_class(name: str) -> list[Episode]:
        chosen = specs if name == "standard" else specs[:22]
        rules = changed(SMALL.rules, {"control_class": name})
        return once(f"in class {name}", lambda _: played(rules, EXPERTS["intercept"](), chosen))

    return in_class


@pytest.fixture(scope="session")
def expert_episodes(in_class: Callable[[str], list[Episode]]) -> list[Episode]:
    return in_class("standard")


@pytest.fixture(scope="session")
def contact_episodes(once: Once) -> list[Episode]:
    """The expert's evaluation on the first 22 episodes of ``test`` under contact, without
    images.
    """
    recipe = changed(SMALL, {"capture": "contact"})
    return once(
        "contact",
        lambda _: played(recipe.rules, EXPERTS["match"](), sample_specs(recipe, range(22))),
    )


@pytest.fixture(scope="session")
def actor(once: Once) -> Path:
    """The checkpoint of a tiny ObAct for images of 32 pixels, which has learned nothing."""
    from tests.checkpoints import tiny_obact  # which takes long to import

    return once("actor", tiny_obact)


@pytest.fixture(scope="session")
def dataset(once: Once) -> Path:
    """Six synthetic episodes with video on disk."""
    return once("dataset", lambda root: write(root, range(6)))
