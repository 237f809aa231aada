"""The environment: a native gymnasium VectorEnv over a WorldBatch; the single Env is a batch of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from dynahoi_lerobot.agent import Observation
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.features import FINGERTIPS, PHASE, STATE, TOUCH
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.renderers import DEFAULT_RENDERER
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.rollout.recorder import Job, WorldRecorder, frame_columns
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import kind_seed, seed_stream

LARGEST_TOUCH_N = 1000.0
ONE_EPISODE_OPTION = "lerobot_new_rollout"
"""Reset option: play one episode in every world, then stand still until the next reset."""
POLICY_NAME = "policy"
EpisodeListener = Callable[[Episode], None]


class DynahoiVectorEnv(VectorEnv):
    """N hands that watch N moving objects and may then catch them.

    Description: in the observation window (the first 20 % of the frames, at least 8) actions are ignored and the hand
    is held still; ``phase`` turns from 0 to 1 when the control phase begins. Then the hand has L control steps.
    Observation: ``pixels/ego`` (H, W, 3) uint8, and likewise each of ``views``; ``agent_pos`` (18,) palm centre [m],
    world, and joint angles [rad]; ``fingertips`` (30,) positions [m] and rotation vectors [rad]; ``phase`` (1,).
    Action: (18,) target for the next frame, palm centre [m], world, and joint angles [rad]; clipped to the limits.
    Reward: 1 at the frame at which the episode ends in success, else 0.
    Episode end: terminated half a second after localisation, truncated after L control steps.
    Info: ``is_success`` at every step; when an episode ends, every metric by name, NaN where it does not apply.
    Autoreset: next step.
    """

    metadata = {  # noqa: RUF012 - gymnasium's own convention
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_HZ,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        kind: str | None = None,
        split: str = "test",
        image_size: int = 128,
        images: bool = True,
        views: Sequence[str] = (),
        appearance: Sequence[str] = (),
        protocol: str = "observe_before_act",
        capture: str = "attach",
        hand: str = "",
        renderer: str = DEFAULT_RENDERER,
        instructions: str = "mixed",
        threads: int = 0,
        render_mode: str | None = "rgb_array",
        on_episode: EpisodeListener | None = None,
    ) -> None:
        """Allocate ``num_envs`` worlds that play episodes of ``split``.

        Args:
            num_envs: N.
            kind: play this kind of motion only; None for all.
            split: ``train``, ``val``, ``test``, ``test_small`` or ``ood_*``.
            image_size: side of the images [px].
            images: whether observations contain images; without them nothing is rendered.
            views: pictures besides those of the hand's camera, under ``pixels``; see `views.py`.
            appearance, protocol, capture, hand, renderer, instructions: see ``Recipe``.
            threads: for physics; 0 for all cores.
            render_mode: ``rgb_array`` or None.
            on_episode: called with every finished Episode.
        """
        self.num_envs, self.kind, self.split, self.render_mode = num_envs, kind, split, render_mode
        self.recipe = Recipe(
            split=seed_stream(split),
            image_size=image_size,
            views=tuple(views),
            appearance=tuple(appearance),
            protocol=protocol,
            capture=capture,
            hand=hand,
            renderer=renderer,
            instructions=instructions,
            motions=() if kind is None or kind in Recipe(split=seed_stream(split)).motion_names else (kind,),
        )
        self._images, self._threads, self._on_episode = images, threads, on_episode
        self._batch = make_batch(self.recipe, num_envs, threads)
        self.single_observation_space = observation_space(
            image_size if images else None, self.recipe.views, touch=self._batch.rule.uses_contact_sensors
        )
        self.single_action_space = spaces.Box(*self._batch.command_limits(), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._recorders: list[WorldRecorder | None] = [None] * num_envs
        self._ended = np.zeros(num_envs, bool)
        self._numbers = np.zeros(num_envs, int)
        self._one_episode = False
        self._seen: Observation | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode in every world.

        Args:
            seed: number of the episode within the split (and kind), one for each world or a first one that counts up;
                None draws numbers at random.
            options: ``{"lerobot_new_rollout": True}`` plays one episode per world and then stands still.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        self._one_episode = bool((options or {}).get(ONE_EPISODE_OPTION, False))
        self._numbers = self._episode_numbers(seed)
        self._begin(np.arange(self.num_envs))
        self._ended[:] = False
        return self._look(), {"is_success": np.zeros(self.num_envs, bool)}

    def step(self, actions: np.ndarray) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every world by one frame; a world whose episode has ended begins the next one instead.

        Raises:
            ValueError: for a wrong shape or a value that is not finite; nothing moves then.
        """
        assert self._seen is not None, "call reset before step"
        playing = np.flatnonzero(~self._ended)
        commands = self._batch.check(actions)
        columns = frame_columns(self._batch, self._seen)
        for i in playing:
            self._recorder(i).see(columns, i, {})
        self._batch.step(commands[playing], playing)
        for i in playing:
            self._recorder(i).act(self._batch.executed[i])
        restarting = np.flatnonzero(self._ended)
        terminated, truncated = self._endings(playing)
        infos = self._infos(terminated | truncated)
        reward = (infos["is_success"] & (terminated | truncated)).astype(np.float64)
        if restarting.size and not self._one_episode:
            self._numbers[restarting] += self.num_envs
            self._begin(restarting)
            self._ended[restarting] = False
        self._ended |= terminated | truncated
        return self._look(), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...]:  # type: ignore[override]
        """Return the current image of every world, (H, W, 3) uint8 each."""
        seen = self._seen.images if self._seen is not None else None
        return tuple(self._batch.render() if seen is None else seen)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return attribute ``name`` of every world, called if it can be; as gymnasium's other vector envs do."""
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
        """Longest episode now being played [frames]; LeRobot asks after every reset."""
        return max(recorder.job.frames for recorder in self._recorders if recorder is not None)

    def _episode_numbers(self, seed: int | Sequence[int | None] | None) -> np.ndarray:
        if seed is None:
            return self.np_random.integers(0, 2**31, self.num_envs)
        if isinstance(seed, int | np.integer):
            return int(seed) + np.arange(self.num_envs)
        if len(seed) != self.num_envs:
            raise ValueError(f"reset needs one seed for each of {self.num_envs} worlds, got {len(seed)}")
        return np.array([int(self.np_random.integers(0, 2**31)) if s is None else s for s in seed])

    def _begin(self, ids: np.ndarray) -> None:
        """Begin episode ``self._numbers[i]`` in each world ``i`` of ``ids``."""
        seeds = [kind_seed(self.recipe, self.split, self.kind, int(self._numbers[i])) for i in ids]
        specs = sample_specs(self.recipe, seeds, threads=max(1, self._threads))
        self._batch.reset(ids, specs)
        for i, spec in zip(ids, specs, strict=True):
            self._recorders[i] = WorldRecorder(Job.evaluation(int(i), spec))

    def _endings(self, playing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) terminated and truncated."""
        terminated, truncated = np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        for i in playing:
            recorder = self._recorder(i)
            terminated[i] = recorder.settled_at(self._batch.rule.settle_frames)
            truncated[i] = recorder.full() and not terminated[i]
        return terminated, truncated

    def _infos(self, ending: np.ndarray) -> dict[str, Any]:
        """``is_success`` so far for all worlds, and every metric for those that end."""
        success = np.array([self._recorder(i).success(self._batch.rule) for i in range(self.num_envs)])
        infos: dict[str, Any] = {"is_success": success}
        for i in np.flatnonzero(ending):
            episode = self._recorder(i).freeze(self._batch.rule, POLICY_NAME)
            if self._on_episode is not None:
                self._on_episode(episode)
            for name, value in measure(episode).items():
                column = infos.setdefault(name, np.full(self.num_envs, np.nan))
                column[i] = np.nan if value is None else value
                infos["_" + name] = ending
        return infos

    def _look(self) -> dict[str, Any]:
        idle = self._ended & self._one_episode
        self._seen = self._batch.observe(images=self._images, ids=np.flatnonzero(~idle))
        return as_gym(self._seen)

    def _recorder(self, i: int) -> WorldRecorder:
        recorder = self._recorders[i]
        assert recorder is not None
        return recorder


class DynahoiEnv(gym.Env):
    """One world: ``DynahoiVectorEnv`` with a batch of one, without the batch axis and without autoreset."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012 - gymnasium's convention

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """Take the keyword arguments of ``DynahoiVectorEnv`` besides ``num_envs``."""
        self._vector = DynahoiVectorEnv(1, render_mode=render_mode, **options)
        self.render_mode = render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin episode ``seed`` of the split (and kind); None draws one."""
        super().reset(seed=seed)
        number = int(self.np_random.integers(0, 2**31)) if seed is None else seed
        observation, infos = self._vector.reset(seed=[number], options={**(options or {}), ONE_EPISODE_OPTION: True})
        return _first(observation), _first(infos)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance by one frame."""
        observation, reward, terminated, truncated, infos = self._vector.step(np.asarray(action)[None])
        return _first(observation), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(infos)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return (H, W, 3) uint8 if the render mode is ``rgb_array``."""
        return self._vector.render()[0] if self.render_mode == "rgb_array" else None

    @property
    def task_description(self) -> str:
        """The instruction."""
        return self._vector.task_description[0]


def observation_space(image_size: int | None, views: Sequence[str] = (), *, touch: bool = False) -> spaces.Dict:
    """Return the space of one world's observations, in the names LeRobot's preprocessing expects."""
    entries: dict[str, gym.Space] = {}
    if image_size is not None:
        picture = spaces.Box(0, 255, (image_size, image_size, 3), np.uint8)
        entries["pixels"] = spaces.Dict(dict.fromkeys(("ego", *views), picture))
    for key, feature, bound in (("agent_pos", STATE, 10.0), ("fingertips", FINGERTIPS, 10.0), ("phase", PHASE, 1.0)):
        entries[key] = spaces.Box(-bound, bound, feature.shape, np.float32)
    if touch:
        entries["touch"] = spaces.Box(0.0, LARGEST_TOUCH_N, TOUCH.shape, np.float32)
    return spaces.Dict(entries)


def as_gym(observation: Observation) -> dict[str, Any]:
    """Return an Observation under the keys of ``observation_space``."""
    entries: dict[str, Any] = {"pixels": observation.pictures} if observation.pictures else {}
    entries |= {} if observation.touch is None else {"touch": np.minimum(observation.touch, LARGEST_TOUCH_N)}
    return {**entries, "agent_pos": observation.state, "fingertips": observation.fingertips, "phase": observation.phase}


def register_envs() -> None:
    """Register ``dynahoi/<kind>-v0`` for every registered motion, and ``dynahoi/all-v0`` for those of the split."""
    for kind in (None, *MOTIONS.names()):
        gym_id = f"dynahoi/{kind or 'all'}-v0"
        if gym_id not in gym.registry:
            gym.register(
                gym_id,
                entry_point="dynahoi_lerobot.env:DynahoiEnv",
                vector_entry_point="dynahoi_lerobot.env:DynahoiVectorEnv",
                kwargs={"kind": kind},
            )


def _first(batched: dict[str, Any]) -> dict[str, Any]:
    return {key: _first(value) if isinstance(value, dict) else value[0] for key, value in batched.items()}
