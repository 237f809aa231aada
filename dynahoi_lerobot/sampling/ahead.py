"""Episodes drawn in a thread, before the worlds that will play them are free."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import batched

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

AT_ONCE = 8
"""Episodes that the thread draws together: few, because a batch that has begun is drawn even if
nobody wants it any more."""


class SpecsAhead:
    """Draws a recipe's episodes, the coming ones in a thread.

    An episode is a function of (recipe, seed), so nothing depends on when it is drawn.
    """

    def __init__(self, recipe: Recipe, *, threads: int = 1, keep: bool = False) -> None:
        """Draw nothing yet.

        Args:
            recipe: what to draw from.
            threads: for rolling targets ahead, of episodes that are wanted at once.
            keep: whether to keep the episodes, to draw each once.
        """
        self._recipe = recipe
        self._threads = max(1, threads)
        self._keep = keep
        self._pool = ThreadPoolExecutor(1, "episodes")  # starts no thread before it has work
        self._coming: dict[int, Future[list[EpisodeSpec]]] = {}
        self._kept: dict[int, EpisodeSpec] = {}

    def take(self, seeds: Sequence[int]) -> list[EpisodeSpec]:
        """Return the episodes of ``seeds``, in order.

        Raises:
            ValueError: as ``sample_specs``.
        """
        known = self._kept | self._arrived(seeds)
        missing = list(dict.fromkeys(seed for seed in seeds if seed not in known))
        drawn = sample_specs(self._recipe, missing, threads=self._threads)
        known |= dict(zip(missing, drawn, strict=True))
        if self._keep:
            self._kept = known
        return [known[seed] for seed in seeds]

    def prepare(self, seeds: Sequence[int]) -> None:
        """Begin to draw the episodes of ``seeds``, and forget all others."""
        wanted = dict.fromkeys(seed for seed in seeds if seed not in self._kept)
        for seed, future in self._coming.items():
            if seed not in wanted:
                future.cancel()
        self._coming = {
            seed: future
            for seed, future in self._coming.items()
            if seed in wanted and not future.cancelled()
        }
        for some in batched([seed for seed in wanted if seed not in self._coming], AT_ONCE):
            future = self._pool.submit(sample_specs, self._recipe, some)
            self._coming |= dict.fromkeys(some, future)

    def close(self) -> None:
        """Stop drawing."""
        self._coming = {}
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _arrived(self, seeds: Sequence[int]) -> dict[int, EpisodeSpec]:
        """Wait for the batches of the thread that contain ``seeds``; return all their episodes. A
        batch that failed is left out: the caller draws its seeds again, which raises the error.
        """
        futures = {self._coming[seed] for seed in seeds if seed in self._coming}
        specs = [spec for one in futures if one.exception() is None for spec in one.result()]
        return {spec.seed: spec for spec in specs}
