"""The simulated robot, and the expert that teleoperates it."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from lerobot.robots import Robot
from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceNotConnectedError

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.evaluate.results import Results, RunInfo, command_line
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.play.live_world import LiveWorld
from dynahoi_lerobot.sampling.fingerprint import surroundings
from dynahoi_lerobot.sampling.splits import stream_label
from lerobot_robot_dynahoi.config_dynahoi import DynahoiExpertConfig, DynahoiRobotConfig

NAMES = FEATURES["action"].names
"""Degrees of freedom as LeRobot calls them, in the order of actions and states."""
PAUSE_S = 0.25
"""LeRobot acts every 0.05 s; an observation this long after the last action begins an episode of LeRobot's own."""

logger = logging.getLogger(__name__)


class _Simulated:
    """What the robot and its teleoperator share: the numbers of a command, and nothing to calibrate."""

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


class DynahoiRobot(_Simulated, Robot):
    """One hand and one moving object; the palm's centre [m], home frame, and 15 joint angles [rad] end in ``.pos``.

    An episode begins with the first action after it was laid out; when it is over the world stands still. The next one
    is laid out when LeRobot begins an episode of its own, which is told by the pause before that, or after the config's
    ``restart_s``.
    """

    config_class = DynahoiRobotConfig
    name = "dynahoi"
    connected: ClassVar[list[DynahoiRobot]] = []
    """The robots that this process has connected, which the expert looks into."""

    def __init__(self, config: DynahoiRobotConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        """Take a config; ``clock`` returns the time [s]."""
        super().__init__(config)
        self.config, self.recipe, self._clock = config, config.recipe, clock
        self.world: LiveWorld | None = None
        self._number = config.seed
        self._acted_s: float | None = None  # when the last action of this episode came
        self._ended_s: float | None = None  # when the episode was seen to be over
        self._results: Results | None = None

    @property
    def cameras(self) -> dict[str, tuple[int, int, int]]:
        """Shape of each camera's images; LeRobot counts them."""
        size = self.recipe.image_size
        return dict.fromkeys((EGO_VIEW, *self.recipe.views), (size, size, 3))

    @property
    def observation_features(self) -> dict[str, Any]:
        """Names of the state's numbers, and the shapes of the images."""
        return {**self.action_features, **self.cameras}

    @property
    def is_connected(self) -> bool:
        """Whether the world exists."""
        return self.world is not None

    def connect(self, calibrate: bool = True) -> None:
        """Make the world and lay out the first episode."""
        del calibrate
        self.world = LiveWorld(self.recipe, self.config.task, realtime=self.config.realtime, clock=self._clock)
        self._begin(self.world)
        DynahoiRobot.connected.append(self)

    def get_observation(self) -> dict[str, Any]:
        """Return the state's numbers by name and the images (H, W, 3) uint8 by camera.

        Raises:
            DeviceNotConnectedError: before ``connect``.
        """
        world, now_s = self._connected_world(), self._clock()
        self._note_end(world)
        restart_s = self.config.restart_s
        paused = self._acted_s is not None and now_s - self._acted_s > PAUSE_S
        if paused or (self._ended_s is not None and restart_s is not None and now_s - self._ended_s >= restart_s):
            self._begin(world)
        observation = world.observe()
        images = {view: image[0] for view, image in observation.images.items()}
        return dict(zip(NAMES, observation.state[0].tolist(), strict=True)) | images

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Give the hand a command, which takes effect in the next frame, and return it.

        Raises:
            DeviceNotConnectedError: before ``connect``.
            ValueError: for a missing number or one that is not finite; the hand follows the last command then.
        """
        if missing := [name for name in NAMES if name not in action]:
            raise ValueError(f"an action of robot dynahoi needs {', '.join(NAMES)}, but has no {missing[0]}")
        world = self._connected_world()
        world.command(np.array([float(action[name]) for name in NAMES]))
        self._acted_s = self._clock()
        self._note_end(world)
        return action

    def disconnect(self) -> None:
        """End the use of the world, and print the metrics of the episodes that were played to their end."""
        if self.world is None:
            return
        self.world = None
        DynahoiRobot.connected.remove(self)
        if self._results is not None and self._results.rows:
            logger.info("\n%s", results_table([self._results]))
            self._results = None

    def _connected_world(self) -> LiveWorld:
        if self.world is None:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect first")
        return self.world

    def _begin(self, world: LiveWorld) -> None:
        world.begin(self._number, self.config.player)
        self._number, self._acted_s, self._ended_s = self._number + 1, None, None
        logger.info("episode %d: %s", self._number - 1, world.spec.task)

    def _note_end(self, world: LiveWorld) -> None:
        """Write down the episode, if it has just ended."""
        world.catch_up()
        if world.finished is None or self._ended_s is not None:
            return
        self._ended_s = self._clock()
        logger.info("episode over: %s; %d frames without a new action", world.finished.stage, world.missed)
        self._results = (self._results or self._no_results()).plus([world.finished])
        if self.config.results_dir is not None:
            self._results.write()

    def _no_results(self) -> Results:
        extra = {"recipe": self.recipe.stored(), "surroundings": surroundings()}
        split, command = stream_label(self.recipe.split, self.recipe.salt), command_line(sys.argv)
        info = RunInfo(self.config.player, split, self.recipe.capture, command, self.recipe.fingerprint(), extra)
        return Results(self.config.results_dir or self.calibration_dir, info)


class DynahoiExpert(_Simulated, Teleoperator):
    """The expert, which knows the target's path, moves the robot that this process has connected."""

    config_class = DynahoiExpertConfig
    name = "dynahoi_expert"

    def __init__(self, config: DynahoiExpertConfig) -> None:
        """Take a config."""
        super().__init__(config)
        self._connected = False

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether ``connect`` was called."""
        return self._connected

    def connect(self, calibrate: bool = True) -> None:
        """Begin to answer."""
        del calibrate
        self._connected = True

    def get_action(self) -> dict[str, float]:
        """Return the expert's command for the robot's present state.

        Raises:
            DeviceNotConnectedError: if this process has no connected robot of type ``dynahoi``.
        """
        world = DynahoiRobot.connected[-1].world if DynahoiRobot.connected else None
        if world is None:
            raise DeviceNotConnectedError("dynahoi_expert moves robots of type dynahoi, and none is connected")
        return dict(zip(NAMES, world.expert_goal().tolist(), strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Ignore it."""

    def disconnect(self) -> None:
        """Stop answering."""
        self._connected = False
