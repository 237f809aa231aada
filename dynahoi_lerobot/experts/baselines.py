"""Baselines: no motion, no prediction, simple predictions of a target seen perfectly, and paths
found blindly.
"""

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.agent import Expert, WorldState, WorldView
from dynahoi_lerobot.core.conventions import CONTROL_DT, PALM_DOF
from dynahoi_lerobot.experts.base import EXPERTS
from dynahoi_lerobot.experts.intercept import EXTRAPOLATED_FRAMES, approach, meeting_goal
from dynahoi_lerobot.hands import HANDS

Command = Callable[[WorldView], np.ndarray]
"""Returns (18,) the command of one world: palm center [m], world, and joint angles [rad]."""
PATH_FILES = {
    "standard": "blind_path.csv",
    "late": "blind_path.csv",
    "unlimited": "blind_path_unlimited.csv",
}
"""By control class: palm positions relative to home [m], one line per frame from the first control
step on; it is what ``benchmarks/validity.py --search`` finds at the speed of the class."""
TABLE_FILE = Path(__file__).with_name("nearest_home.csv")
"""One line for each home: its position [m], world, then palm positions relative to it [m], one for
each frame from the first control step on; it is what ``benchmarks/validity.py --search --homes``
finds."""


@EXPERTS.register("hold")
class Hold(Expert):
    """Commands its current pose."""

    privileged = False

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18), the measured state."""
        return world.observation.state.astype(np.float64)


@EXPERTS.register("pursuit")
class Pursuit(Expert):
    """Chase the target's current true position at full speed; its score needs no prediction.

    Its recordings suit policies that see too little of the past to predict.
    """

    labels_any_state = True

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        return approach(world, _standing(world), world.control.palm_speed_m_s)

    def goal(self, world: WorldView) -> np.ndarray:
        """Return (18,) where the target is, and fingers that close by time to go; after the catch,
        the held pose.
        """
        return meeting_goal(world, _standing(world), world.control.palm_speed_m_s)


def baseline(name: str, *, privileged: bool = True) -> Callable[[Command], Command]:
    """Return a decorator that registers a function of one world as the expert ``name``; its
    docstring describes it.
    """

    def decorate(command: Command) -> Command:
        members = {
            "privileged": privileged,
            "command": staticmethod(command),
            "__doc__": command.__doc__,
        }
        EXPERTS.register(name)(type(name, (Expert,), members))
        return command

    return decorate


@baseline("constant_velocity")
def constant_velocity(world: WorldView) -> np.ndarray:
    """Extrapolate the true velocity and replan in every frame, at the control class's full
    speed.
    """
    moved = _ahead_s(world) * world.target_velocity_w
    return approach(world, world.target_pos_w + moved, world.control.palm_speed_m_s)


@baseline("constant_acceleration")
def constant_acceleration(world: WorldView) -> np.ndarray:
    """Extrapolate the true velocity and acceleration and replan in every frame, at full speed."""
    ahead_s = _ahead_s(world)
    moved = ahead_s * world.target_velocity_w + ahead_s**2 / 2 * _acceleration(world)
    return approach(world, world.target_pos_w + moved, world.control.palm_speed_m_s)


@baseline("blind_path", privileged=False)
def blind_path(world: WorldView) -> np.ndarray:
    """Follow a fixed path from home with closed fingers; its score needs neither perception nor
    prediction.

    The path is the best one found for the speed of the control class.
    """
    return _along(fixed_path(world.control.name), world)


@baseline("nearest_home")
def nearest_home(world: WorldView) -> np.ndarray:
    """Follow the stored path of the nearest tabulated home; its score shows what the home gives
    away.

    Policies cannot do this: they observe positions from their home, wherever that is.
    """
    homes_w, paths = home_table()
    return _along(paths[np.linalg.norm(homes_w - world.spec.home_pos_w, axis=1).argmin()], world)


def _standing(world: WorldView) -> np.ndarray:
    """Return (K, 3) the path [m], world, of a target that stays where it is."""
    return np.tile(world.target_pos_w, (EXTRAPOLATED_FRAMES + 1, 1))


def _ahead_s(world: WorldView) -> np.ndarray:
    """Return (K, 1) the times [s] from now at which the target may be met, the first when a command
    takes effect.
    """
    return (world.control.latency_frames + np.arange(EXTRAPOLATED_FRAMES + 1))[:, None] * CONTROL_DT


def _along(path: np.ndarray, world: WorldView) -> np.ndarray:
    """Return (18,) the next command of a closed hand on a path (K, 3) [m] from home."""
    step = min(world.due_frame - world.spec.window_frames, len(path) - 1)
    return np.concatenate([world.spec.home_pos_w + path[step], fist(world.spec.hand)])


def _acceleration(world: WorldView) -> np.ndarray:
    """Return (3,) the mean acceleration [m/s^2] over the last two frames of the untouched
    target.
    """
    frame = min(max(world.frame, 2), len(world.spec.target_path_w) - 1)
    before, last, now = world.spec.target_path_w[frame - 2 : frame + 1]
    return (now - 2 * last + before) / CONTROL_DT**2


@functools.cache
def fixed_path(control_class: str) -> np.ndarray:
    """Return (K, 3) palm positions relative to home [m] after 1, 2, ... control steps.

    Raises:
        ValueError: for a control class without a stored path.
    """
    if control_class not in PATH_FILES:
        known = ", ".join(PATH_FILES)
        raise ValueError(
            f"blind_path has no stored path for control class {control_class!r}, only for {known}"
        )
    return np.loadtxt(Path(__file__).with_name(PATH_FILES[control_class]), delimiter=",", ndmin=2)


@functools.cache
def fist(hand: str) -> np.ndarray:
    """(15,) joint angles [rad] around an object of no size."""
    return HANDS[hand].reference_joints(0.0)


@functools.cache
def home_table() -> tuple[np.ndarray, np.ndarray]:
    """Return (H, 3) homes [m], world, and (H, K, 3) palm positions from there [m] after 1, 2, ...
    control steps.
    """
    table = np.loadtxt(TABLE_FILE, delimiter=",", ndmin=2)
    return table[:, :PALM_DOF], table[:, PALM_DOF:].reshape(len(table), -1, PALM_DOF)
