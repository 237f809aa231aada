"""N worlds as a native ``gymnasium.vector.VectorEnv`` over one ``WorldBatch``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from dynahoi_lerobot.agent import Observation
from dynahoi_lerobot.control_class import DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.env.checks import RENDER_MODES, check_open, check_render_mode, check_seed, episode_numbers
from dynahoi_lerobot.env.rebuilt_copies import RebuiltCopies
from dynahoi_lerobot.env.rewards import SPARSE, check_reward
from dynahoi_lerobot.env.running_episodes import EpisodeListener, RunningEpisodes
from dynahoi_lerobot.env.shared_attributes import SharedAttributes
from dynahoi_lerobot.env.spaces import as_gym, observation_space
from dynahoi_lerobot.features import frame_features
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ, EGO_VIEW, SEED_LIMIT
from dynahoi_lerobot.protocol import DEFAULT_PROTOCOL
from dynahoi_lerobot.renderers import DEFAULT_RENDERER
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import kind_seed, seed_stream

ONE_EPISODE_OPTION = "lerobot_new_rollout"
"""Reset option: play one episode in every world, then stand still until the next reset."""


class DynahoiVectorEnv(RebuiltCopies, SharedAttributes):
    """N hands that watch N moving objects and may then catch them.

    Description:
        A floating five-fingered hand (3 palm translations, 15 flexion joints) and a target that moves on a path of its
        own, at 20 Hz. In the observation window (the first 20 % of the frames, at least 8) actions are ignored and the
        hand is held still; ``phase`` turns from [1, 0] to [0, 1] when the control phase begins. Then the hand has L
        control steps. SI units; positions are in the home frame: axes of the world, z up, origin where the palm's
        centre waits in this episode, so that the palm begins at (0, 0, 0).
    Observation:
        A dictionary of ``features.FEATURES`` by ``gym_key``: ``pixels``, a dictionary of (H, W, 3) uint8 RGB images by
        view, ``ego`` (the hand's camera) first; ``agent_pos`` (18,) palm centre [m], home frame, and joint angles
        [rad]; ``phase`` (2,); and, if the
        capture rule uses contact sensors, ``touch`` (5,) force of each finger on the target [N]. Only on request
        ``environment_state`` (13,), the simulator's truth: pose of the target [m, 1], home frame, and its linear and
        angular velocity [m/s, rad/s].
    Action:
        (18,) float32 target for the next frame: palm centre [m], home frame, and joint angles [rad]. The palm's bounds
        are the length of the gantry's slides either way (4, 4 and 2.48 m), the same in every episode; where on the
        slides the home lies is not told. Clipped to the joint ranges and, in the world, to the slides; cut to the speed
        of the control class: the norm of the palm's velocity to 0.5 m/s (``standard``, ``late``) or 2 m/s
        (``unlimited``), joints to 20 rad/s; under ``contact`` each axis of the palm to 2 m/s. It takes effect at once,
        or after 150 ms (``late``).
    Reward:
        1 at the frame at which the episode ends in success, else 0 (``sparse``); see `rewards.py` for ``dense``.
    Episode end:
        Terminated when the capture rule's verdict falls, half a second (``attach``) after localisation; truncated
        after L control steps and one more, whose action has no consequence: it records what the last one led to.
        Autoreset: the next step begins the world's next episode and ignores its action.
    Info:
        ``is_success`` (N,) bool at every step; when an episode ends also every metric by name, (N,) float64, NaN where
        it does not apply, with its mask ``_<name>``.
    Options:
        ``reset(options={"lerobot_new_rollout": True})`` plays one episode per world and then stands still.

    Copies (``pickle``, ``deepcopy``) have the same constructor arguments and begin before their first reset.
    """

    metadata = {  # noqa: RUF012 - gymnasium's own convention
        "render_modes": list(RENDER_MODES),
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
        protocol: str = DEFAULT_PROTOCOL,
        control_class: str = DEFAULT_CONTROL_CLASS,
        capture: str = "attach",
        hand: str = "",
        renderer: str = DEFAULT_RENDERER,
        instructions: str = "mixed",
        salt: str = "",
        environment_state: bool = False,
        reward: str = SPARSE,
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
            views: views besides ``ego``, such as ``side``; see `renderers/camera_views.py`.
            appearance, protocol, control_class, capture, hand, renderer, instructions, salt: see ``Recipe``.
            environment_state: whether observations contain the simulator's truth, for state-only baselines.
            reward: ``sparse`` or ``dense``.
            threads: for physics; 0 for all cores.
            render_mode: ``rgb_array`` or None.
            on_episode: called with every finished Episode.

        Raises:
            ValueError: for an unknown name or a value out of range, naming those allowed.
        """
        self.num_envs, self.kind, self.split, self.render_mode = num_envs, kind, split, render_mode
        self.recipe = Recipe(
            split=seed_stream(split),
            image_size=image_size,
            views=tuple(views),
            appearance=tuple(appearance),
            protocol=protocol,
            control_class=control_class,
            capture=capture,
            hand=hand,
            renderer=renderer,
            instructions=instructions,
            salt=salt,
            motions=() if kind is None or kind in Recipe(split=seed_stream(split)).motion_names else (kind,),
        )
        self._images, self._threads, self._on_episode, self.reward = images, threads, on_episode, reward
        self.environment_state = environment_state
        self._allocate()

    def _allocate(self) -> None:
        """Check the options that are no recipe's, and make the worlds and what is known of their episodes."""
        check_render_mode(self.render_mode)
        check_reward(self.reward)
        n = self.num_envs
        self._batch = make_batch(self.recipe, n, self._threads, environment_state=self.environment_state)
        self._set_spaces()
        self._episodes = RunningEpisodes(self._batch, self._on_episode, self.reward)
        self._ended, self._numbers = np.zeros(n, bool), np.zeros(n, int)
        self._one_episode = False

    def _set_spaces(self) -> None:
        """Derive the spaces from the feature table and the hand's limits."""
        image_size, contact_sensors = self.recipe.image_size, self._batch.rule.uses_contact_sensors
        size = image_size if self._images else None
        features = frame_features(
            size, self.recipe.views, contact_sensors=contact_sensors, environment_state=self.environment_state
        )
        self.single_observation_space = observation_space(features)
        self.single_action_space = spaces.Box(*self._batch.command_limits(), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode in every world.

        Args:
            seed: number of the episode within the split (and kind), 0 to 2^40 - 1, one for each world or a first one
                that counts up; None draws numbers at random. Later episodes count on, from the last number to 0.
            options: see the class.

        Raises:
            ValueError: for a seed that is not such an integer, or a wrong number of them.
            ClosedEnvironmentError: after ``close``.
        """
        check_open(self.closed)
        numbers = episode_numbers(seed, self.num_envs, self._seeded(seed))
        self._one_episode = bool((options or {}).get(ONE_EPISODE_OPTION, False))
        self._numbers = numbers
        self._begin(np.arange(self.num_envs))
        self._ended[:] = False
        return self._observe(), {"is_success": np.zeros(self.num_envs, bool)}

    def step(self, actions: np.ndarray) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every world by one frame of 0.05 s; a world whose episode has ended begins the next one instead.

        Args:
            actions: (N, 18) targets for the next frame, palm centres [m], home frame, and joint angles [rad].

        Raises:
            ValueError: for a wrong shape or element type, or a value that is not finite; nothing moves then.
            ResetNeeded: before the first ``reset``.
            ClosedEnvironmentError: after ``close``.
        """
        self._observed()
        ended = self._episodes.step(actions)
        restarting = np.flatnonzero(self._ended)
        terminated, truncated = (np.isin(np.arange(self.num_envs), ids) for ids in (ended.settled, ended.full))
        infos = self._episodes.infos(ended.worlds)
        reward = self._episodes.rewards(terminated | truncated)
        if restarting.size and not self._one_episode:
            self._numbers[restarting] = (self._numbers[restarting] + self.num_envs) % SEED_LIMIT
            self._begin(restarting)
            self._ended[restarting] = False
        self._ended |= terminated | truncated
        return self._observe(ended.worlds), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...]:  # type: ignore[override]
        """Return the current image of every world's ``ego`` view, (H, W, 3) uint8 each.

        Raises:
            ResetNeeded: before the first ``reset``.
            ClosedEnvironmentError: after ``close``.
        """
        images = self._observed().images
        return tuple(images[EGO_VIEW] if images else self._batch.cameras.render())

    def _observed(self) -> Observation:
        """The latest observation; there is one between the first ``reset`` and ``close``."""
        check_open(self.closed)
        if self._episodes.observation is None:
            raise ResetNeeded("call reset first: no episode has begun")
        return self._episodes.observation

    def _seeded(self, seed: int | Sequence[int | None] | None) -> np.random.Generator:
        """The generator of random episode numbers, begun anew from ``seed`` if that is one number."""
        if isinstance(seed, int | np.integer):
            super().reset(seed=check_seed(seed))
        return self.np_random

    def _begin(self, ids: np.ndarray) -> None:
        """Begin episode ``self._numbers[i]`` in each world ``i`` of ``ids``."""
        seeds = [kind_seed(self.recipe, self.split, self.kind, int(self._numbers[i])) for i in ids]
        specs = sample_specs(self.recipe, seeds, threads=max(1, self._threads))
        self._episodes.begin_specs(ids, specs)

    def _observe(self, ending: np.ndarray | None = None) -> dict[str, Any]:
        """Return what is seen now; worlds ``ending`` (n,) show their last frame, those that ended before are black."""
        return as_gym(self._episodes.observe(images=self._images, ending=ending))
