"""Who moves the hand. A learned agent sees an Observation; an expert sees the WorldState; the types
keep them apart.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import FINGER_DOF, HAND_DOF
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.core.spec import EpisodeSpec


@dataclass(frozen=True, eq=False)
class Observation:
    """What a policy may see of N worlds at one frame.

    The home frame has the axes of the world and its origin where the palm waits in this episode.

    Attributes:
        images: (N, H, W, 3) uint8 RGB by view, ``ego`` (the hand's camera) first; empty if nothing
            was rendered.
        state: (N, 18) float32, palm center position [m], home frame, and joint angles [rad].
        phase: (N, 2) float32, [1, 0] observing, [0, 1] acting.
        tasks: N instructions.
        touch: (N, 5) float32 force of each finger on the target [N], None unless the capture rule
            uses_contact_sensors.
        environment_state: (N, 13) float32, the simulator's truth: pose and velocity of the target
            as in `WorldState`, [m], quaternion, [m/s] and [rad/s]; None unless the recipe asks for
            it.
        sighting: (N, 14) float32, where the eye sees the target, see `features.py`; None unless the
            recipe asks for it.
    """

    images: dict[str, np.ndarray]
    state: np.ndarray
    phase: np.ndarray
    tasks: tuple[str, ...]
    touch: np.ndarray | None = None
    environment_state: np.ndarray | None = None
    sighting: np.ndarray | None = None

    def of(self, worlds: np.ndarray) -> Self:
        """Return what is seen of some worlds (n,)."""
        arrays = {
            name: None if value is None else value[worlds]
            for name, value in vars(self).items()
            if name not in {"images", "tasks"}
        }
        images = {view: pixels[worlds] for view, pixels in self.images.items()}
        return replace(self, images=images, tasks=tuple(self.tasks[i] for i in worlds), **arrays)


@dataclass(frozen=True, eq=False)
class WorldState:
    """Everything the simulator knows of N worlds at one frame; for experts only.

    Attributes:
        observation: as a policy would receive it.
        specs: the N episodes being played, None where no world is in use; each knows its untouched
            target's path.
        frame: (N,) int, frame index within the episode.
        attempt: (N,) int, 1 for the first try at an episode.
        target_pose_h: (N, 7) position [m], home frame, and quaternion wxyz.
        target_velocity_w: (N, 6) linear [m/s] and angular [rad/s], along the world's axes.
        localized: (N,) bool, the target has been localized in the control phase.
        control: the limits of the hand and the latency of its commands.
        localization_radius_m: palm center to target center, below which the target is localized
            [m].
        state_when_due: (N, 18) where undisturbed hands will be when a command given now takes
            effect: [m], home frame, and [rad].
    """

    observation: Observation
    specs: tuple[EpisodeSpec | None, ...]
    frame: np.ndarray
    attempt: np.ndarray
    target_pose_h: np.ndarray
    target_velocity_w: np.ndarray
    localized: np.ndarray
    control: ControlClass
    localization_radius_m: float
    state_when_due: np.ndarray


@dataclass(frozen=True, eq=False)
class WorldView:
    """What is known of one world at one frame; unlike ``WorldState``, in the world frame, as the
    episode is drawn.

    Attributes:
        spec: the episode.
        state: (18,) where the hand will be when a command given now takes effect: palm center [m],
            world, and joint angles [rad].
        frame: of the episode, now.
        due_frame: the frame at which the command takes effect; in the observation window, the first
            that does.
        target_pos_w: (3,) position of the target now [m], world.
        target_velocity_w: (3,) its linear velocity now [m/s], world.
        localized: the target has been localized.
        control: limits of the hand, and latency.
        localization_radius_m: palm center to target center, below which the target is localized
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

    @classmethod
    def of(cls, world: WorldState, i: int, spec: EpisodeSpec) -> Self:
        """Return the state of world ``i``, which plays ``spec``."""
        frame = int(world.frame[i])
        return cls(
            spec=spec,
            state=world.state_when_due[i] + _origin(spec),
            frame=frame,
            due_frame=max(frame + world.control.latency_frames, spec.window_frames),
            target_pos_w=world.target_pose_h[i, :3] + spec.home_pos_w,
            target_velocity_w=world.target_velocity_w[i, :3],
            localized=bool(world.localized[i]),
            control=world.control,
            localization_radius_m=world.localization_radius_m,
        )


@dataclass(frozen=True, eq=False)
class Meeting:
    """Where and when a hand is going to meet its target.

    Attributes:
        palm_pos_w: (3,) the palm center then [m], world.
        frame: of the episode.
    """

    palm_pos_w: np.ndarray
    frame: int


class Actor(ABC):
    """Whoever moves the hands of N worlds: an `Agent` from observations, an `Expert` from the
    simulator's state.

    Attributes:
        name: labels results.
        privileged: it sees the simulator's state; results say so.
        has_memory: what it does depends on earlier frames, so that all worlds must begin their
            episodes together.
        sees_images: turns rendering on.
        environment_state: the ``environment_state`` that it needs of the rules; empty for none,
            None if it needs one and does not tell which.
        control_mode: meaning of its commands, one of ``CONTROL_MODES``; None for the rules' own.
        trained_for: values of fields of the `Rules` that it was trained for, such as
            ``image_size``, as far as it tells.
        views: the views it needs besides ``ego``.
        weights: sha256 of its files of weights, by name; empty if it has none.
        retries: how often it may begin a failed episode again; ``WorldState.attempt`` tells it that
            it does.
        labels: (N, 18) what a teacher wanted from the frames it last gave commands for, as
            commands; None if nobody labels them, so that the commands stand for themselves.
    """

    name: str = "actor"
    privileged: bool
    has_memory: bool
    sees_images: bool = False
    environment_state: str | None = ""
    control_mode: str | None = None
    trained_for: Mapping[str, Any] = MappingProxyType({})
    views: tuple[str, ...] = ()
    weights: Mapping[str, str] = MappingProxyType({})
    retries: int = 0
    labels: np.ndarray | None = None

    def reset(self, count: int) -> None:  # noqa: B027 - an actor without memory has nothing to forget
        """Forget everything; ``count`` new episodes begin."""

    def leave(self, worlds: np.ndarray) -> None:  # noqa: B027 - most actors command them all
        """Note that the episodes of ``worlds`` (n,) have ended; nobody executes what is commanded
        there until the next ``reset``.
        """

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass) -> Meeting | None:
        """Return the meeting that it plans at the control start; None if it plans none."""
        return None

    def report(self) -> dict[str, Any]:
        """Return what else a result should say about the run, as JSON values."""
        return {}

    @abstractmethod
    def commands(
        self, observation: Observation, world_state: Callable[[Observation], WorldState]
    ) -> np.ndarray:
        """Return (N, 18) commands: palm position [m], home frame, and joint angles [rad] for the
        next frame; or (N, 4) in control mode ``grasp``.

        Args:
            observation: as a policy may see it.
            world_state: gives everything the simulator knows; an `Agent` never calls it.
        """


class Agent(Actor):
    """Maps observations of N worlds to N commands; it cannot see more.

    An agent that ``plans`` can also say what it would do in the next frames. Then not every frame
    asks it for something, and it observes the others.

    Attributes:
        plans: whether it has ``plan``.
        accepts_guidance: whether a plan can continue what the previous one has committed to.
    """

    name = "agent"
    privileged = False
    has_memory = True
    plans: bool = False
    accepts_guidance: bool = False

    def commands(
        self, observation: Observation, world_state: Callable[[Observation], WorldState]
    ) -> np.ndarray:
        """Return (N, 18) commands."""
        return self.act(observation)

    @abstractmethod
    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) commands: palm position [m], home frame, and joint angles [rad] for the
        next frame.
        """

    def observe(self, observation: Observation) -> None:
        """Note a frame in which neither a command nor a plan is asked for."""

    def plan(
        self,
        observation: Observation,
        worlds: np.ndarray,
        *,
        executed: np.ndarray | None = None,
        delays: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Infer a chunk of commands for each of some worlds; it counts as observing the frame.

        Args:
            observation: of all worlds.
            worlds: (n,) sorted worlds that need a chunk.
            executed: (n,) actions of each previous chunk that are past, to continue the others;
                None for chunks that continue nothing.
            delays: (n,) actions that will be past when each chunk is ready; None for none.

        Returns:
            (n, H, 18) commands for the observed frame and those after it, and (n,) what the
            inference took [s].
        """
        raise NotImplementedError(f"{self.name!r} does not plan")


class Expert(Actor):
    """Maps the full simulator state of N worlds to N commands, deterministically, world by world.

    It defines ``command`` of one world, or ``act`` of all. A world may begin an episode at any
    frame of the others. What an expert keeps between frames, such as a plan, must follow from the
    episode and the attempt alone.

    Attributes:
        labels_any_state: it is a function of the state alone, so that it can say what it wants in
            whatever state somebody else gets into; it then defines ``goal``.
    """

    name = "expert"
    privileged = True
    has_memory = False
    control_mode = JOINTS
    labels_any_state: ClassVar[bool] = False

    def commands(
        self, observation: Observation, world_state: Callable[[Observation], WorldState]
    ) -> np.ndarray:
        """Return (N, 18) commands."""
        return self.act(world_state(observation))

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world: palm center [m], world, and joint angles [rad]."""
        raise NotImplementedError(f"{self.name!r} defines neither command nor act")

    def goal(self, world: WorldView) -> np.ndarray:
        """Return (18,) where the hand of one world should get to, and how far closed it should be
        now.

        Palm center [m], world, which may lie beyond the reach of one frame, and joint angles [rad].
        In the observation window this is where the hand should be if control were active; after
        the catch the hand holds still.
        """
        return self.command(world)

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) commands: palm position [m], home frame, and joint angles [rad] for the
        next frame; worlds without an episode get zeros.
        """
        return _each(world, self.command)

    def label(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) the goals, home frame, or the commands of an expert that labels its own
        states alone; worlds without an episode get zeros.
        """
        return _each(world, self.goal) if self.labels_any_state else self.act(world)


def _each(world: WorldState, command: Callable[[WorldView], np.ndarray]) -> np.ndarray:
    """(N, 18) what ``command`` says for each world, world frame, in its home frame; zeros without
    an episode.
    """
    commands = np.zeros((len(world.specs), HAND_DOF))
    for i, spec in enumerate(world.specs):
        if spec is not None:
            commands[i] = command(WorldView.of(world, i, spec)) - _origin(spec)
    return commands


def _origin(spec: EpisodeSpec) -> np.ndarray:
    """(18,) of the home frame: the home [m], world, and zero for the joints."""
    return np.concatenate([spec.home_pos_w, np.zeros(FINGER_DOF)])
