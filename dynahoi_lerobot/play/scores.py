"""Results of episodes that are played live, kept as ``dynahoi evaluate`` keeps its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.evaluate.results import Results, RunInfo

if TYPE_CHECKING:
    from dynahoi_lerobot.core.episode import Episode
    from dynahoi_lerobot.sampling.recipe import Recipe


@dataclass
class Scores:
    """What was played so far, written to its folder after every episode.

    Attributes:
        results: of those episodes.
        kept: whether they have a folder.
    """

    results: Results
    kept: bool

    def add(self, episode: Episode) -> None:
        """Count an episode."""
        self.results = self.results.plus([replace(episode, images={})])
        if self.kept:
            self.results.write()


@contextmanager
def scores_of(player: str, recipe: Recipe, folder: Path | None) -> Iterator[Scores]:
    """Hold ``folder``, if there is one, and go on with what ``player`` has played there.

    Raises:
        BlockingIOError: if another process works in the folder.
        FileExistsError: if it holds something else.
    """
    info = RunInfo.begun(player, recipe, inference="")
    with working_folder(folder, info.task()) if folder else nullcontext():
        yield Scores(Results.resumed(folder, info) if folder else Results(Path(), info), folder is not None)
