"""Episodes that were drawn ahead are those that are drawn when they are asked for."""

import numpy as np
import pytest

from dynahoi_lerobot.sampling import ahead
from dynahoi_lerobot.sampling.ahead import SpecsAhead
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

TRAIN = Recipe(motions=("constant", "lob"))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds in the order in which they are drawn."""
    seeds: list[int] = []

    def sample(recipe: Recipe, some: tuple[int, ...], *, threads: int = 1) -> list:
        seeds.extend(some)
        return sample_specs(recipe, some, threads=threads)

    monkeypatch.setattr(ahead, "sample_specs", sample)
    return seeds


def test_what_is_prepared_is_what_is_drawn_at_once(drawn: list[int]):
    specs = SpecsAhead(TRAIN)
    specs.prepare(range(4, 15))
    found = specs.take([9, 3, 4, 9])
    for one, other in zip(found, sample_specs(TRAIN, [9, 3, 4, 9]), strict=True):
        np.testing.assert_equal(vars(one), vars(other))
    specs.close()
    assert drawn.count(9) == drawn.count(3) == 1


def test_each_episode_is_drawn_once_if_it_is_kept(drawn: list[int]):
    specs = SpecsAhead(TRAIN, keep=True)
    for seeds in ([0, 1], [2, 0], [1, 2]):
        assert [spec.seed for spec in specs.take(seeds)] == seeds
        specs.prepare(range(3))
    specs.close()
    assert sorted(drawn) == [0, 1, 2]


def test_preparing_in_vain_harms_nobody(drawn: list[int]):
    specs = SpecsAhead(TRAIN)
    specs.prepare([-1, 5])  # fails, as no seed is negative
    assert [spec.seed for spec in specs.take([5])] == [5]
    specs.prepare(range(100))
    specs.prepare([200])
    assert [spec.seed for spec in specs.take([200])] == [200]
    with pytest.raises(ValueError, match="a seed must be"):
        specs.take([-1])
    specs.close()
    assert len(drawn) < 50, "what is no longer wanted is not drawn"
