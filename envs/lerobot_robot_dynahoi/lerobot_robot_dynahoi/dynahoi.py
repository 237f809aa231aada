"""The simulated robot."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, ClassVar

import numpy as np
from lerobot.robots import Robot
from lerobot.utils.errors import DeviceNotConnectedError

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.core.lerobot_internals import recording_loop
from dynahoi_lerobot.dataset.paths import ROBOT_TYPE
from dynahoi_lerobot.evaluate.results import Results, RunInfo, kept_results
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.play.live_world import LiveWorld
from lerobot_robot_dynahoi.config_dynahoi import DynahoiRobotConfig

NAMES = FEATURES["action"].names
"""Degrees of freedom as LeRobot calls them, in the order of actions and states."""
PAUSE_S, LONG_PAUSE_S = 0.25, 1.0
"""LeRobot acts every 0.05 s. Where it has no loop over episodes, an observation this long after the
last action begins an episode of its own: the first where the world's episode is over, the second in
the middle of it, where a slow policy also lets time pass."""

logger = logging.getLogger(__name__)


class Simulated:
    """What the robot and its teleoperators share: the numbers of a command, and nothing to
    calibrate.
    """

    @property
    def action_features(self) -> dict[str, type]:
        """Names of a command's numbers."""
        return dict.fromkeys(NAMES, float)

    @property
    def is_calibrated(self) -> bool:
        """True: a simulated hand needs no calibration."""
        return True

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""


class DynahoiRobot(Simulated, Robot):
    """One hand and one moving object; the palm's center [m], home frame, and 15 joint angles [rad]
    end in ``.pos``.

    An episode begins with the first action after it was laid out; when it is over the world stands
    still. The next one is laid out when LeRobot begins an episode of its own: when its recording
    loop begins (see ``recording_loop``), else when it comes back from a pause, or, where LeRobot
    has no episodes, after the config's ``restart_s``. While paused, LeRobot may send the same dict
    again and again; that neither ends the pause nor begins an episode.
    """

    config_class = DynahoiRobotConfig
    name = ROBOT_TYPE  # LeRobot writes it into datasets, and merges datasets of the same robot
    connected: ClassVar[list[DynahoiRobot]] = []
    """The robots that this process has connected, which teleoperators look into."""

    def __init__(
        self, config: DynahoiRobotConfig, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        """Take a config; ``clock`` returns the time [s]."""
        super().__init__(config)
        self.config = config
        self.recipe = config.recipe
        self._clock = clock
        self._world: LiveWorld | None = None
        self._number = config.seed  # of the next episode
        self._acted_s: float | None = None  # when the last action of this episode came
        self._recorded: float | None = None  # when LeRobot's last loop began that recorded
        self._sent: dict[str, Any] | None = (
            None  # LeRobot sends the same dict again while it is paused
        )
        self._ended_s: float | None = None  # when the episode was seen to be over
        self._results: Results
        self._open = ExitStack()

    @property
    def cameras(self) -> dict[str, tuple[int, int, int]]:
        """Shape of each camera's images; LeRobot counts them."""
        rules = self.recipe.rules
        size = rules.image_size
        return dict.fromkeys((EGO_VIEW, *rules.views), (size, size, 3))

    @property
    def observation_features(self) -> dict[str, Any]:
        """Names of the state's numbers, and the shapes of the images."""
        return {**self.action_features, **self.cameras}

    @property
    def is_connected(self) -> bool:
        """Whether the world exists."""
        return self._world is not None

    @property
    def world(self) -> LiveWorld:
        """The world.

        Raises:
            DeviceNotConnectedError: before ``connect``.
        """
        if self._world is None:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect first")
        return self._world

    def connect(self, calibrate: bool = True) -> None:
        """Make the world and lay out the first episode, after the episodes of ``results_dir``.

        Raises:
            BlockingIOError: if another process works in ``results_dir``.
            FileExistsError: if ``results_dir`` holds something else.
        """
        del calibrate
        info = RunInfo.begun(self.config.player, self.recipe, inference="")
        self._results = self._open.enter_context(kept_results(self.config.results_dir, info))
        self._number = self.config.seed + len(self._results.rows)
        self._world = LiveWorld(
            self.recipe, self.config.task, realtime=self.config.realtime, clock=self._clock
        )
        self._begin()
        DynahoiRobot.connected.append(self)

    def get_observation(self) -> dict[str, Any]:
        """Return the state's numbers by name and the images (H, W, 3) uint8 by camera.

        Raises:
            DeviceNotConnectedError: before ``connect``.
        """
        asked_s = self._clock()  # before the results are written, which takes a while
        self._note_end()
        if self._next_is_due(asked_s):
            self._begin()
        observation = self.world.observe()
        images = {view: image[0] for view, image in observation.images.items()}
        return dict(zip(NAMES, observation.state[0].tolist(), strict=True)) | images

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Give the hand a command, which takes effect in the next frame, and return it.

        Raises:
            DeviceNotConnectedError: before ``connect``.
            ValueError: for a missing number or one that is not finite; the hand follows the last
                command then.
        """
        missing = [name for name in NAMES if name not in action]
        if missing:
            raise ValueError(
                f"an action of robot dynahoi needs {', '.join(NAMES)}, but has no {missing[0]}"
            )
        held = action is self._sent
        self._sent = action
        if held and self._acted_s is None and self.config.restart_s is None:
            return action
        self.world.command(np.array([float(action[name]) for name in NAMES]))
        self._note_end()
        if not held or self._ended_s is None:
            self._acted_s = self._clock()
        return action

    def disconnect(self) -> None:
        """End the use of the world, and print the metrics of the episodes that were played to their
        end.
        """
        if self._world is None:
            return
        self._note_end()
        if self._acted_s is not None and self._ended_s is None:
            logger.info(
                "the episode breaks off in frame %d and does not count", self.world.batch.frame[0]
            )
        self._world = None
        DynahoiRobot.connected.remove(self)
        self._open.close()
        if self._results.rows:
            logger.info("\n%s", results_table([self._results]))

    def _next_is_due(self, now_s: float) -> bool:
        ended_s = self._ended_s
        restart_s = self.config.restart_s
        if restart_s is not None:
            return ended_s is not None and now_s - ended_s >= restart_s
        loop = recording_loop()
        if loop is not None:
            began_s, records = loop
            begins = records and began_s != self._recorded
            self._recorded = began_s if records else self._recorded
            return begins and self._acted_s is not None
        return self._acted_s is not None and now_s - self._acted_s > (
            LONG_PAUSE_S if ended_s is None else PAUSE_S
        )

    def _begin(self) -> None:
        self.world.begin(self._number, self.config.player)
        logger.info("episode %d: %s", self._number, self.world.spec.task)
        self._number = self._number + 1
        self._acted_s = None
        self._ended_s = None

    def _note_end(self) -> None:
        """Write down the episode, if it has just ended."""
        self.world.catch_up()
        episode = self.world.finished
        if episode is not None and self._ended_s is None:
            self._ended_s = self._clock()
            logger.info(
                "episode over: %s; %d frames without a new action", episode.stage, self.world.missed
            )
            self._results = self._results.plus([episode])
            if self.config.results_dir:
                self._results.write()
