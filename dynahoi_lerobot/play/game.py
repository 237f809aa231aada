"""A person's evaluation: episode after episode at the page, each followed by its metrics and by how
others did.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.escaping import data_url
from dynahoi_lerobot.evaluate.gif import encode_gif, phases_of
from dynahoi_lerobot.metrics import METRICS, measure
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.world.batch import WorldBatch

if TYPE_CHECKING:
    from dynahoi_lerobot.core.agent import Actor
    from dynahoi_lerobot.core.episode import Episode
    from dynahoi_lerobot.play.live_world import LiveWorld
    from dynahoi_lerobot.play.server import Player

PRACTICE_STEP = 7919
"""Practice takes every so many episodes of its stream, so that all kinds of motion take turns."""
SHOWN = ("S_loc", "S_gra", "E_loc", "E_gra", "Q_smooth", "Q_line", "R_time")
"""The paper's seven metrics."""
CLIP_PX = 192
PRACTICE = "practice"
SCORED = "scored"


@dataclass
class Game:
    """What is played at the page.

    Attributes:
        world: in which scored episodes are played.
        practice: in which the others are.
        numbers: of the scored episodes that are left.
        total: how many scored episodes there are in all.
        player: name in the recordings.
        others: play every episode again, to be compared: the expert and, if given, a policy.
        keep: takes each scored episode, and says where it went.
    """

    world: LiveWorld
    practice: LiveWorld
    numbers: list[int]
    total: int
    player: str
    others: Sequence[Actor]
    keep: Callable[[Episode], None]
    practised: int = 0

    async def __call__(self, player: Player) -> None:
        """Play with ``player`` until they leave."""
        while True:
            await player.tell(
                ready={"left": len(self.numbers), "total": self.total, "practised": self.practised}
            )
            asked = await player.asked.get()
            if asked is None:
                return
            practising = asked != SCORED or not self.numbers
            world = self.practice if practising else self.world
            episode = await self._play(player, world, practising)
            if practising:
                self.practised += 1
            else:
                self.numbers.pop(0)
                self.keep(episode)
            if not player.gone:
                await player.tell(
                    result=await asyncio.to_thread(self._result, world, episode, practising)
                )

    async def _play(self, player: Player, world: LiveWorld, practising: bool) -> Episode:
        """Play one episode; the world goes on if the page is closed in the middle of it."""
        number = PRACTICE_STEP * (self.practised + 1) if practising else self.numbers[0]
        world.begin(number, self.player)
        while (episode := world.finished) is None:
            await player.show(world.observe().images[EGO_VIEW][0], **world.facts)
            await asyncio.sleep(world.rest_s)
            world.command(player.steering.command(world))
        return episode

    def _result(self, world: LiveWorld, episode: Episode, practising: bool) -> dict:
        """Return the page's summary of an episode: metrics and clips of the player and of the
        others.
        """
        spec = world.spec
        rows = [("you", episode)]
        for actor in self.others:
            rules = world.recipe.rules
            shown = replace(rules, views=tuple(dict.fromkeys((*rules.views, *actor.views))))
            batch = WorldBatch(shown, 1)
            rows.append((actor.name, next(evaluate(batch, actor, [spec], images=True))))
        return {
            "practice": practising,
            "task": spec.task,
            "units": {name: METRICS[name].unit for name in SHOWN},
            "players": [
                {"name": name, "stage": played.stage, "success": bool(played.success)}
                | {
                    "metrics": {name: measure(played)[name] for name in SHOWN},
                    "clip": _clip(played),
                }
                for name, played in rows
            ],
        }


def _clip(episode: Episode) -> str:
    """Return the hand's images of an episode as the ``data:`` address of a GIF."""
    frames: np.ndarray = episode.images[EGO_VIEW]
    gif = encode_gif(frames, phases=phases_of(episode), min_width=CLIP_PX)
    return data_url("image/gif", gif)
