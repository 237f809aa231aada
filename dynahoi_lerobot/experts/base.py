"""What experts and privileged baselines share: the registry, and looking at one world at a time."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.agent import Expert, WorldState
from dynahoi_lerobot.core.conventions import FINGER_DOF, HAND_DOF
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.core.spec import EpisodeSpec

EXPERTS: Registry[type[Expert]] = Registry("expert")


@dataclass(frozen=True, eq=False)
class WorldView:
    """What is known of one world at one frame; unlike ``WorldState``, in the world frame, as the
    episode is drawn.

    Attributes:
        spec: the episode.
        state: (18,) where the hand will be when a command given now takes effect: palm centre [m],
            world, and joint angles [rad].
        frame: of the episode, now.
        due_frame: the frame at which the command takes effect; in the observation window, the first
            that does.
        target_pos_w: (3,) position of the target now [m], world.
        target_velocity_w: (3,) its linear velocity now [m/s], world.
        localized: the target has been localised.
        control: limits of the hand, and latency.
        localization_radius_m: palm centre to target centre, below which the target is localised
            [m].
    """

    spec: EpisodeSpec
    state: np.ndarray
    frame: int
    due_frame: int
    target_pos_w: np.ndarray
    target_velocity_w: np.ndarray
    localized: bool
    control: ControlClass
    localization_radius_m: float


class SingleWorldExpert(Expert):
    """An expert that looks at one world at a time, in the world frame."""

    @abstractmethod
    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world: palm centre [m], world, and joint angles [rad]."""

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) commands, home frame; worlds without an episode get zeros."""
        return _each(world, self.command)


class Teacher(SingleWorldExpert):
    """An expert that is a function of the state alone, so that it can label whatever state somebody
    else gets into.
    """

    @abstractmethod
    def goal(self, world: WorldView) -> np.ndarray:
        """Return (18,) where the hand of one world should get to, and how far closed it should be
        now.

        Palm centre [m], world, which may lie beyond the reach of one frame, and joint angles [rad].
        In the observation window it is what the teacher would command were control active; after
        the catch it holds still.
        """

    def goals(self, state: WorldState) -> np.ndarray:
        """Return (N, 18) the goals, home frame; worlds without an episode get zeros."""
        return _each(state, self.goal)


def _each(world: WorldState, command: Callable[[WorldView], np.ndarray]) -> np.ndarray:
    """(N, 18) what ``command`` says for each world, world frame, in its home frame; zeros without
    an episode.
    """
    commands = np.zeros((len(world.specs), HAND_DOF))
    for i, spec in enumerate(world.specs):
        if spec is not None:
            commands[i] = command(_view(world, i, spec)) - _origin(spec)
    return commands


def _view(world: WorldState, i: int, spec: EpisodeSpec) -> WorldView:
    return WorldView(
        spec=spec,
        state=world.state_when_due[i] + _origin(spec),
        frame=int(world.frame[i]),
        due_frame=max(int(world.frame[i]) + world.control.latency_frames, spec.window_frames),
        target_pos_w=world.target_pose[i, :3] + spec.home_pos_w,
        target_velocity_w=world.target_velocity[i, :3],
        localized=bool(world.localized[i]),
        control=world.control,
        localization_radius_m=world.localization_radius_m,
    )


def _origin(spec: EpisodeSpec) -> np.ndarray:
    """(18,) of the home frame: the home [m], world, and zero for the joints."""
    return np.concatenate([spec.home_pos_w, np.zeros(FINGER_DOF)])
