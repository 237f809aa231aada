"""N worlds as a native ``gymnasium.vector.VectorEnv`` over one ``WorldBatch``, and one world as a
``gymnasium.Env``.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import CONTROL_HZ, EGO_VIEW, FINGER_DOF, PALM_DOF, SEED_LIMIT
from dynahoi_lerobot.core.episode import Episode, closure, potential
from dynahoi_lerobot.core.features import Feature, as_gym
from dynahoi_lerobot.core.lerobot_internals import ONE_EPISODE_OPTION
from dynahoi_lerobot.core.nested import changed, field_names
from dynahoi_lerobot.core.protocols import is_acting
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.metrics import METRICS, measure
from dynahoi_lerobot.rollout.inference import StepwiseInference
from dynahoi_lerobot.rollout.loop import Session
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.sampling.ahead import SpecsAhead
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seed
from dynahoi_lerobot.world.batch import WorldBatch

DEFAULT_RECIPE = Recipe(split="test")
RENDER_MODES = ("rgb_array",)
RANDOM_SEED_LIMIT = 2**31
"""Seeds that the environment draws itself are below this."""
SPARSE = "sparse"
DENSE = "dense"
REWARDS = {
    SPARSE: "1 at the first step that begins in a frame by which the episode is a success, else 0",
    DENSE: "the same, plus in the control phase P(s') - P(s), the change of P = c exp(-d) - d: how "
    "much closer palm and target have come, and how much better the hand is closed near the target",
}
"""Name: formula. ``d`` is the distance from palm center to target center in units of 0.1 m, and
``c`` the closure, 0 to 1, see ``core.episode.potential``. This is potential-based shaping (Ng,
Harada and Russell, 1999, gamma = 1): its sum over an episode is P(last) - P(first), which depends
on these two states only, so it changes no policy's rank. P is at most 1, of a closed hand at the
target, and falls by 1 for each 0.1 m of distance."""


class DynahoiVectorEnv(VectorEnv):
    """N hands that watch N moving objects and may then catch them.

    Description:
        A floating five-fingered hand (3 palm translations, 15 flexion joints) and a target that
        moves on a path of its own, at 20 Hz. In the observation window (the first 20 % of the
        frames, at least 8) actions are ignored and the hand stays still; ``phase`` changes from [1,
        0] to [0, 1] when the control phase of L steps begins. SI units; positions are in the home
        frame: axes of the world, z up, origin at the palm's start.
    Observation:
        A dictionary of ``features.FEATURES`` by ``gym_key``: ``pixels``, a dictionary of (H, W, 3)
        uint8 RGB images by view, ``ego`` (the hand's camera) first; ``agent_pos`` (18,) palm center
        [m], home frame, and joint angles [rad]; ``phase`` (2,); and, if the capture rule uses
        contact sensors, ``touch`` (5,) force of each finger on the target [N]. Only on request
        ``environment_state``: the simulator's truth (13,), pose of the target [m, 1], home frame,
        and its linear and angular velocity [m/s, rad/s]; or (14,) where the eye sees it
        (`core/features.py`).
    Action:
        (18,) float32 target for the next frame: palm center [m], home frame, and joint angles
        [rad]. The palm's bounds are the length of the gantry's slides either way (4, 4 and 2.48 m),
        the same in every episode, so that they do not give away where on the slides the hand
        starts. Clipped to the joint ranges and to the slides, and limited to the speed of the
        control class: the norm of the palm's velocity to 0.5 m/s (``standard``, ``late``) or 2 m/s
        (``unlimited``), joints to 20 rad/s; under ``contact`` each axis of the palm to 2 m/s. It
        takes effect at once, or after 150 ms (``late``). With ``control_mode="grasp"`` (4,): the
        palm's displacement from its current position [m], and the closure of the hand, 0 to 1.
    Reward:
        One of ``REWARDS``: 1 when the episode has become a success, else 0 (``sparse``), or
        progress towards the target and of the grasp as well (``dense``).
    Episode end:
        Terminated when the outcome is settled, half a second (``attach``) after localization;
        truncated after L + 1 control steps, of which the last ignores its action and records where
        the one before led. What happens then is the autoreset mode's: the next step begins the
        world's next episode and ignores its action (``NEXT_STEP``); the same step begins it, and
        info has ``final_obs`` and ``final_info`` of the episode that ended (``SAME_STEP``); or the
        world stands still, black in images, until a reset (``DISABLED``).
    Info:
        At every step and reset ``is_success`` (N,) bool and every metric by name, (N,) float64,
        with its mask ``_<name>``: NaN and False where no episode ends, where ``max_episode_steps``
        cuts it short, or where the metric does not apply.
    Options:
        ``reset(options={"lerobot_new_rollout": True})`` plays one episode in every world, then
        waits for a reset. ``reset(options={"reset_mask": mask})`` begins episodes in the worlds of
        ``mask`` (N,) bool alone.

    Copies (``pickle``, ``deepcopy``) are constructed anew from the same arguments and need a reset.
    Attributes are ``recipe``, ``kind``, ``episodes``, ``reward`` and ``autoreset_mode``.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}  # noqa: RUF012 - gymnasium's convention

    def __init__(
        self,
        num_envs: int = 1,
        *,
        recipe: Recipe = DEFAULT_RECIPE,
        kind: str | None = None,
        episodes: int | None = None,
        reward: str = SPARSE,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = "rgb_array",
        on_episode: Callable[[Episode], None] | None = None,
        inference: StepwiseInference | None = None,
        max_episode_steps: int | None = None,
        **fields: Any,
    ) -> None:
        """Allocate ``num_envs`` worlds that play episodes of a recipe.

        Args:
            num_envs: N.
            recipe: the episodes; by default split ``test`` under the default rules.
            kind: play this kind of motion only; None for all of the recipe.
            episodes: play the first so many episodes (of the kind) over and over, each of which is
                drawn once; None for all.
            reward: one of ``REWARDS``.
            autoreset_mode: gymnasium's, or the value of one, such as ``SameStep``; see the class.
            threads: for physics; 0 for all cores.
            render_mode: ``rgb_array`` or None.
            on_episode: called with every finished Episode.
            inference: timing of a policy whose inferences take time, for this env alone. A step is
                then one call of the policy: some calls only fetch more of a chunk, return the same
                observation and advance no world.
            max_episode_steps: truncate every episode after so many steps, if it has not ended
                before; episodes that are cut short are not measured.
            fields: fields of the recipe or its rules to change, such as ``split="val"`` or
                ``image_size=96``; see ``Recipe`` and ``Rules``.

        Raises:
            TypeError: for a keyword that is neither an argument nor a field.
            ValueError: for an unknown name or a value out of range, naming those allowed.
        """
        unknown = fields.keys() - set(field_names(Recipe))
        if unknown:
            raise TypeError(
                f"{type(self).__name__} got an unexpected keyword argument {min(unknown)!r}; "
                f"fields of the recipe: {', '.join(field_names(Recipe))}"
            )
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps must be at least 1, got {max_episode_steps}")
        if render_mode is not None:
            known("render mode", render_mode, dict.fromkeys(RENDER_MODES))
        known("reward", reward, REWARDS)
        self.num_envs = num_envs
        self.render_mode = render_mode
        if episodes is not None and episodes < 1:
            raise ValueError(f"episodes must be at least 1, or None for all, got {episodes}")
        self.kind = kind
        self.episodes = episodes
        self.reward = reward
        self.recipe = changed(recipe, fields)
        if kind is not None and kind not in self.recipe.motion_names:
            self.recipe = replace(self.recipe, motions=(kind,))
        rules = self.recipe.rules
        if inference is not None and rules.control_mode != JOINTS:
            raise ValueError(
                f"inference async needs control_mode {JOINTS!r}, got {rules.control_mode!r}"
            )
        mode = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self.autoreset_mode = known(
            "autoreset mode", mode, {one.value: one for one in AutoresetMode}
        )
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self._threads = threads
        self._on_episode = on_episode
        self._inference = inference
        self._specs = SpecsAhead(self.recipe, threads=threads, keep=episodes is not None)
        self._step_limit = max_episode_steps
        self._batch = WorldBatch(rules, num_envs, threads)
        self._session = Session(self._batch, record_images=False)
        self.single_observation_space = observation_space(rules.features)
        self.single_action_space = spaces.Box(*self._batch.commands.limits(), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._numbers = np.zeros(num_envs, int)  # of the episodes, within split and kind
        self._max_frames = np.zeros(num_envs, int)  # of each world's episode
        self._cut = np.zeros(num_envs, bool)  # whether ``max_episode_steps`` shortens it
        self._success, self._ended = np.zeros((2, num_envs), bool)
        self._potential = np.zeros(num_envs)  # at the last frame, for ``DENSE``
        self._one_episode = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode in every world, or in the worlds of ``reset_mask``.

        Args:
            seed: number of the episode within the split (and kind), 0 to 2^40 - 1: one for each
                world, or one for the first world, from which the others count up; None draws at
                random. Each later episode of a world has its number plus N, modulo 2^40, also after
                a reset of some worlds with None.
            options: see the class.

        Raises:
            ValueError: for a seed that is not such an integer, a wrong number of them, a mask that
                is not (N,) bool, or if inference takes time and worlds would begin their next
                episodes at different frames.
            ResetNeeded: for a mask that leaves out worlds in which no episode has begun.
            ClosedEnvironmentError: after ``close``.
        """
        self._check_open()
        options = options or {}
        one_episode = bool(options.get(ONE_EPISODE_OPTION, False))
        mask = self._mask(options.get("reset_mask"))
        if self._inference is not None and not (one_episode and mask.all()):
            option = f"options={{{ONE_EPISODE_OPTION!r}: True}}"
            raise ValueError(f"with inference async all worlds begin together; reset with {option}")
        if seed is None and not mask.all():
            numbers = (self._numbers + self.num_envs) % SEED_LIMIT
        else:
            numbers = self._draw_numbers(seed)
        self._numbers = np.where(mask, numbers, self._numbers)
        self._one_episode = one_episode or self.autoreset_mode == AutoresetMode.DISABLED
        if self._inference is not None:
            self._inference.reset()
        self._begin(np.flatnonzero(mask))
        self._ended[mask] = False
        return as_gym(self._session.observe()), self._unmeasured()

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every world by one frame of 0.05 s; a world whose episode has ended begins the
        next one instead.

        Args:
            actions: (N, 18) targets for the next frame, palm centers [m], home frame, and joint
                angles [rad].

        Raises:
            ValueError: for a wrong shape or element type, or a value that is not finite; nothing
                moves then.
            ResetNeeded: before the first ``reset``.
            ClosedEnvironmentError: after ``close``.
        """
        before = self._observed()
        if np.shape(actions)[1:] != self.single_action_space.shape:
            raise ValueError(
                f"action must have shape {self.action_space.shape}, got {np.shape(actions)}"
            )
        if self._inference is not None:
            commands = self._batch.commands.read(actions, before.state)
            due = self._inference.answer(commands, before.state.astype(np.float64))
            if due is None:
                terminated, truncated = np.zeros((2, self.num_envs), bool)
                rewards = np.zeros(self.num_envs)
                return as_gym(before), rewards, terminated, truncated, self._unmeasured()
            actions = due
        terminated, truncated = self._session.step(actions)
        ending = terminated | truncated
        succeeded_before = self._success.copy()
        infos = self._infos(ending, truncated & self._cut)
        rewards = self._rewards(is_acting(before.phase), ending, succeeded_before)
        if self._one_episode:
            restarting = np.zeros(self.num_envs, bool)
        elif self.autoreset_mode == AutoresetMode.SAME_STEP:
            restarting = ending
            infos = self._final(infos, ending) if ending.any() else infos
        else:
            restarting = self._ended.copy()
        if restarting.any():
            self._numbers[restarting] = (self._numbers[restarting] + self.num_envs) % SEED_LIMIT
            self._begin(np.flatnonzero(restarting))
        self._ended = (self._ended | ending) & ~restarting
        if self.autoreset_mode == AutoresetMode.SAME_STEP and restarting.any():
            infos["is_success"] = self._success.copy()
        # episodes that end now show their last frame; worlds whose episode ended before are black
        shown = np.flatnonzero(ending & ~restarting)
        return as_gym(self._session.observe(ending=shown)), rewards, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...]:  # type: ignore[override]
        """Return the current image of every world's ``ego`` view, (H, W, 3) uint8 each.

        Raises:
            ResetNeeded: before the first ``reset``.
            ClosedEnvironmentError: after ``close``.
        """
        images = self._observed().images
        return tuple(images[EGO_VIEW] if images else self._batch.cameras.render())

    def close_extras(self, **kwargs: Any) -> None:
        """Stop drawing episodes."""
        self._specs.close()

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return attribute ``name`` of every world, called if it is callable, like gymnasium's
        other vector envs.
        """
        value = getattr(self, name)
        if name == "render":
            return value()
        result = value(*args, **kwargs) if callable(value) else value
        return tuple(result) if isinstance(result, list) else (result,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return attribute ``name`` of every world."""
        return self.call(name)

    @property
    def task(self) -> str:
        """The kind of motion, or ``all``."""
        return self.kind or "all"

    @property
    def task_description(self) -> list[str]:
        """The instruction of every world."""
        return ["" if spec is None else spec.task for spec in self._batch.specs]

    @property
    def _max_episode_steps(self) -> int:
        """Steps after which every episode now being played has ended; LeRobot reads it after every
        reset.
        """
        frames = int(self._max_frames.max())
        return frames if self._inference is None else self._inference.calls(frames)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs: the constructor's arguments and gymnasium's ``spec``."""
        names = (
            "num_envs", "recipe", "kind", "episodes", "reward", "render_mode", "autoreset_mode",
        )  # fmt: skip
        arguments: dict[str, Any] = {name: getattr(self, name) for name in names}
        arguments |= {"threads": self._threads, "on_episode": self._on_episode}
        arguments["max_episode_steps"] = self._step_limit
        return {
            "arguments": arguments | {"inference": copy.deepcopy(self._inference)},
            "spec": self.spec,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Construct the copy."""
        self.__init__(**state["arguments"])
        self.spec = state["spec"]

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedEnvironmentError("this environment was closed; make a new one")

    def _observed(self) -> Observation:
        """The latest observation; refused before the first ``reset`` and after ``close``."""
        self._check_open()
        if self._session.observation is None:
            raise ResetNeeded("call reset first: no episode has begun")
        return self._session.observation

    def _mask(self, mask: np.ndarray | None) -> np.ndarray:
        """(N,) bool, the worlds to reset, see ``reset``."""
        if mask is None:
            return np.ones(self.num_envs, bool)
        given = np.asarray(mask)
        if given.dtype != bool or given.shape != (self.num_envs,) or not given.any():
            raise ValueError(
                f"reset_mask must be {self.num_envs} bool, one of them True, got {mask!r}"
            )
        if self._session.observation is None and not given.all():
            raise ResetNeeded("call reset without reset_mask first: no episode has begun")
        return given

    def _draw_numbers(self, seed: int | Sequence[int | None] | None) -> np.ndarray:
        """(N,) int64, the number of each world's first episode, see ``reset``."""
        n = self.num_envs
        if seed is None:
            return self.np_random.integers(0, RANDOM_SEED_LIMIT, n)
        if not isinstance(seed, Sequence | np.ndarray) or isinstance(seed, str):
            super().reset(seed=(first := check_seed(seed)))
            return np.array([check_seed(first + i) for i in range(n)], np.int64)
        if len(seed) != n:
            raise ValueError(f"reset needs one seed for each of {n} worlds, got {len(seed)}")
        drawn = (
            self.np_random.integers(0, RANDOM_SEED_LIMIT) if one is None else check_seed(one)
            for one in seed
        )
        return np.fromiter(drawn, np.int64, n)

    def _begin(self, ids: np.ndarray) -> None:
        """Begin the evaluation of episode ``self._numbers[i]`` in each world ``i`` of ``ids``."""
        specs = self._specs.take(self._seeds(self._numbers[ids]))
        if not self._one_episode:
            self._specs.prepare(self._seeds((self._numbers + self.num_envs) % SEED_LIMIT))
        jobs = [Job.evaluation(int(i), spec) for i, spec in zip(ids, specs, strict=True)]
        limit = self._step_limit or np.inf
        self._cut[ids] = [limit < job.frames for job in jobs]
        jobs = [replace(job, frames=int(min(job.frames, limit))) for job in jobs]
        self._session.begin(ids, jobs)
        self._max_frames[ids] = [job.frames for job in jobs]
        self._success[ids] = False
        self._potential = self._measured_potential()

    def _seeds(self, numbers: np.ndarray) -> list[int]:
        """Return the seeds of (n,) episodes, by their numbers."""
        within = numbers if self.episodes is None else numbers % self.episodes
        return [kind_seed(self.recipe, self.kind, number) for number in within.tolist()]

    def _infos(self, ending: np.ndarray, cut: np.ndarray) -> dict[str, Any]:
        """Finish the episodes of worlds ``ending`` (N,) bool and measure all that were not
        ``cut`` (N,) bool; return the step's infos, see the class.
        """
        for i in self._session.playing:
            self._success[i] = self._session.success(int(i))
        infos = self._unmeasured()
        for i in np.flatnonzero(ending):
            episode = self._session.finish(int(i), "policy")
            if cut[i]:
                continue
            if self._on_episode is not None:
                self._on_episode(episode)
            for name, value in measure(episode).items():
                infos[name][i] = np.nan if value is None else value
                infos["_" + name][i] = value is not None
        return infos

    def _unmeasured(self) -> dict[str, np.ndarray]:
        """Return the infos of a step with which no episode ends, see the class."""
        infos: dict[str, np.ndarray] = {"is_success": self._success.copy()}
        for name in METRICS.names():
            infos[name] = np.full(self.num_envs, np.nan)
            infos["_" + name] = np.zeros(self.num_envs, bool)
        return infos

    def _final(self, infos: dict[str, Any], ending: np.ndarray) -> dict[str, Any]:
        """Return the infos of a step that also begins episodes where they are ``ending`` (N,) bool,
        see the class.
        """
        last = as_gym(self._batch.observe(ids=np.flatnonzero(ending)))
        observations = np.full(self.num_envs, None, object)
        for i in np.flatnonzero(ending):
            observations[i] = _of_world(last, i)
        final = infos | {"_is_success": ending}
        return self._unmeasured() | {
            "final_obs": observations,
            "_final_obs": ending,
            "final_info": final,
            "_final_info": ending,
        }

    def _rewards(
        self, acted: np.ndarray, ending: np.ndarray, succeeded_before: np.ndarray
    ) -> np.ndarray:
        """(N,) reward of a step, see ``REWARDS``; (N,) bool each: its action took effect, the
        episode ends with it, it was a success before.
        """
        rewards = (self._success & ~succeeded_before).astype(np.float64)
        if self.reward == DENSE:
            before = self._potential
            self._potential = self._measured_potential()
            playing = np.isin(np.arange(self.num_envs), self._session.playing) | ending
            rewards += np.where(acted & playing, self._potential - before, 0.0)
        return rewards

    def _measured_potential(self) -> np.ndarray:
        """(N,) see `potential`."""
        state = self._batch.state
        specs = self._batch.specs
        still = np.zeros(FINGER_DOF)
        opened = np.stack([still if spec is None else spec.open_joints for spec in specs])
        wanted = np.stack([still if spec is None else spec.reference_joints for spec in specs])
        target_pos_h = self._batch.target_pose_h[:, :PALM_DOF]
        distance_m = np.linalg.norm(target_pos_h - state[:, :PALM_DOF], axis=1)
        return potential(distance_m, closure(state[:, PALM_DOF:], opened, wanted))


class DynahoiEnv(gym.Env):
    """One hand and one moving object: ``DynahoiVectorEnv`` for a single world, without batch axis
    and autoreset.

    Description, observation, action, reward, episode end and options are as in
    ``DynahoiVectorEnv``. Info has the same names without the masks, with Python's own scalars; a
    metric is 0 before the end of the episode, and then NaN where it does not apply. After the end
    of an episode the world stands still until ``reset``. Copies (``pickle``, ``deepcopy``) have the
    same constructor arguments and begin before their first reset.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}  # noqa: RUF012 - gymnasium's convention

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """Take the keyword arguments of ``DynahoiVectorEnv`` besides ``num_envs``.

        Raises what ``DynahoiVectorEnv`` raises.
        """
        self._options = {"render_mode": render_mode, **options}
        self._vector = DynahoiVectorEnv(1, **self._options)
        self.render_mode = render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: number of the episode within the split (and kind), 0 to 2^40 - 1; None draws one.
            options: none are known.

        Raises what ``DynahoiVectorEnv.reset`` raises.
        """
        number = None if seed is None else check_seed(seed)
        super().reset(seed=number)
        if number is None:
            number = int(self.np_random.integers(0, RANDOM_SEED_LIMIT))
        observation, infos = self._vector.reset(seed=[number], options={ONE_EPISODE_OPTION: True})
        return _of_world(observation, 0), _scalars(infos, ended=False)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance by one frame of 0.05 s.

        Args:
            action: (18,) target for the next frame, palm center [m], home frame, and joint angles
                [rad].

        Raises what ``DynahoiVectorEnv.step`` raises.
        """
        observation, reward, terminated, truncated, infos = self._vector.step(
            np.asarray(action)[None]
        )
        return (
            _of_world(observation, 0),
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _scalars(infos, ended=bool(terminated[0] or truncated[0])),
        )

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return the image of the hand's camera, (H, W, 3) uint8, or None if the render mode is
        None.
        """
        return self._vector.render()[0] if self.render_mode is not None else None

    def close(self) -> None:
        """End the use of the environment; closing it again has no effect."""
        self._vector.close()

    @property
    def task_description(self) -> str:
        """The instruction."""
        return self._vector.task_description[0]

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs: the constructor's arguments."""
        return {"options": self._options, "spec": self.spec}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Construct the copy."""
        self.__init__(**state["options"])
        self.spec = state["spec"]


def observation_space(features: Sequence[Feature]) -> spaces.Dict:
    """Return the space of one world's observations: a Box for each of ``features`` that policies
    see.
    """
    groups: dict[str, dict[str, spaces.Space]] = {"": {}}
    for feature in features:
        if feature.observed and feature.gym_key is not None:
            group, _, key = feature.gym_key.rpartition("/")
            box = spaces.Box(feature.low, feature.high, feature.shape, np.dtype(feature.dtype).type)
            groups.setdefault(group, {})[key] = box
    ungrouped = groups.pop("")
    return spaces.Dict(
        {**{group: spaces.Dict(boxes) for group, boxes in groups.items()}, **ungrouped}
    )


def check_seed(seed: Any) -> int:
    """Return ``seed`` as an int; ValueError if it is not an integer from 0 to 2^40 - 1."""
    if (
        isinstance(seed, bool | np.bool_)
        or not isinstance(seed, int | np.integer)
        or not 0 <= seed < SEED_LIMIT
    ):
        raise ValueError(f"a seed must be an integer from 0 to 2^40 - 1, got {seed!r}")
    return int(seed)


def _of_world(batched: dict[str, Any], i: int) -> dict[str, Any]:
    return {
        key: _of_world(value, i) if isinstance(value, dict) else value[i]
        for key, value in batched.items()
    }


def _scalars(infos: dict[str, np.ndarray], *, ended: bool) -> dict[str, bool | float]:
    """Return the infos of one world without masks; metrics are 0 until its episode has ``ended``.

    Gymnasium's checker compares the infos of two steps, and NaN equals nothing.
    """
    names = [name for name in infos if not name.startswith("_")]
    return {
        name: infos[name][0].item() if ended or not np.isnan(infos[name][0]) else 0.0
        for name in names
    }
