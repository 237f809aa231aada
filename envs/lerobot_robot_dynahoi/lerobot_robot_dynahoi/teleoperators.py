"""Who moves the simulated robot: the expert, or a person at a page."""

from __future__ import annotations

import asyncio
import logging
import secrets
from abc import abstractmethod
from concurrent.futures import Future
from threading import Event, Thread
from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceNotConnectedError

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.play.live_world import LiveWorld
from dynahoi_lerobot.play.server import LOOPBACK, Player, PlayServer
from dynahoi_lerobot.play.steering import Steering
from lerobot_robot_dynahoi.config_dynahoi import DynahoiBrowserConfig, DynahoiExpertConfig
from lerobot_robot_dynahoi.dynahoi import NAMES, DynahoiRobot, Simulated

logger = logging.getLogger(__name__)


class _Mover(Simulated, Teleoperator):
    """Moves the robot that this process has connected."""

    _connected = False

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether it is between ``connect`` and ``disconnect``."""
        return self._connected

    def connect(self, calibrate: bool = True) -> None:
        """Begin to answer."""
        del calibrate
        self._connected = True

    def get_action(self) -> dict[str, float]:
        """Return the command for the robot's present state.

        Raises:
            DeviceNotConnectedError: if this process has no connected robot of type ``dynahoi``.
        """
        if not DynahoiRobot.connected:
            raise DeviceNotConnectedError(
                f"{self.name} moves robots of type dynahoi, and none is connected"
            )
        return dict(
            zip(NAMES, self._command(DynahoiRobot.connected[-1].world).tolist(), strict=True)
        )

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Ignore it."""

    def disconnect(self) -> None:
        """Stop answering."""
        self._connected = False

    @abstractmethod
    def _command(self, world: LiveWorld) -> np.ndarray:
        """Return (18,) the command for the hand now."""


class DynahoiExpert(_Mover):
    """The expert, which knows the target's path."""

    config_class = DynahoiExpertConfig
    name = "dynahoi_expert"

    def _command(self, world: LiveWorld) -> np.ndarray:
        return world.expert_goal()


class DynahoiBrowser(_Mover):
    """A person at the page of ``dynahoi play``, which LeRobot's loop shows a frame at every action
    it asks for.

    Nobody at the page, the hand stays where it is and opens.
    """

    config_class = DynahoiBrowserConfig
    name = "dynahoi_browser"

    def __init__(self, config: DynahoiBrowserConfig) -> None:
        """Take a config."""
        super().__init__(config)
        token = "" if config.host in LOOPBACK else secrets.token_urlsafe(16)
        self.server = PlayServer(self._show, config.host, config.port, token)
        self._player: Player | None = None
        self._view: tuple[np.ndarray, dict[str, Any]] | None = (
            None  # the newest image, and facts about it
        )
        self._came = Event()

    def connect(self, calibrate: bool = True) -> None:
        """Serve the page, print its address, and wait until somebody opens it.

        Raises:
            OSError: if the address cannot be listened on.
        """
        started: Future[str] = Future()
        self._loop = asyncio.new_event_loop()
        self._serving = self._loop.create_task(self.server.run(started.set_result))
        self._serving.add_done_callback(
            lambda task: started.done() or started.set_exception(task.exception())
        )
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()
        print(f"open {started.result()} to begin", flush=True)
        self._came.wait()
        super().connect(calibrate)

    def disconnect(self) -> None:
        """Close the page's connection and stop serving."""
        super().disconnect()
        self._loop.call_soon_threadsafe(self._serving.cancel)
        self._thread.join()

    def _command(self, world: LiveWorld) -> np.ndarray:
        self._view = (world.observe().images[EGO_VIEW][0], world.facts)
        player = self._player
        return (player.steering if player else Steering()).command(world)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(asyncio.wait([self._serving]))
        self._loop.close()

    async def _show(self, player: Player) -> None:
        """Send a player every new view until they leave."""
        self._player = player
        shown = None
        self._came.set()
        while not player.gone:
            view = self._view
            if view is not None and view is not shown:
                await player.show(view[0], **view[1])
                shown = view
            await asyncio.sleep(0.005)
        self._player = None
