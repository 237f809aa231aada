"""An episode before it is accepted: what has been drawn for its seed so far, and drawing it again."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from dynahoi_lerobot.appearance import Appearance
from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.motions import MOTIONS, Draw, Motion
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from dynahoi_lerobot.protocol import protocol_of
from dynahoi_lerobot.sampling.furniture import furnish
from dynahoi_lerobot.sampling.instructions import draw_instruction
from dynahoi_lerobot.sampling.randomization import randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.salt import salt_words
from dynahoi_lerobot.sampling.screen import with_screen
from dynahoi_lerobot.sampling.timing import Timing, draw_timing

MIN_OBSERVED_S = 0.25
"""A target that is released must be seen moving for this long before control starts."""
MAX_SPIN_RAD_S = 2.0
MAX_SEED = 2**63 - 1
"""Datasets and results store seeds as int64."""


@dataclass(eq=False)
class Candidate:
    """One episode under construction. Every draw comes from ``rng``, which nothing but recipe and seed decides.

    Attributes:
        recipe, seed: what the episode is a function of.
        kind: its kind of motion; kinds take turns with the seed.
        rng: the episode's random numbers.
        timing: frames and travel last drawn.
        motion, target: motion and object last drawn; unset before the first ``draw_motion``.
    """

    recipe: Recipe
    seed: int
    kind: type[Motion]
    rng: np.random.Generator
    timing: Timing = field(init=False)
    motion: Motion = field(init=False)
    target: TargetObject = field(init=False)

    @classmethod
    def start(cls, recipe: Recipe, seed: int) -> Self:
        """Return the candidate of a seed, with its first timing.

        Raises:
            ValueError: if the seed is negative or too large to be stored, or of the recipe's salt only a hash is known.
        """
        if not 0 <= seed <= MAX_SEED:
            raise ValueError(f"a seed must be 0 to {MAX_SEED}, got {seed}")
        names = recipe.motion_names
        rng = np.random.default_rng([zlib.crc32(recipe.stream.encode()), seed, *salt_words(recipe.salt)])
        candidate = cls(recipe, seed, MOTIONS[names[seed % len(names)]], rng)
        candidate.draw_timing()
        return candidate

    def draw_timing(self) -> None:
        """Draw duration and travel, and leave the capture rule the frames it needs after the intercept."""
        timing = draw_timing(self.kind.name, self.recipe.protocol, self.rng)
        shortest = timing.intercept_frame + 1 + CAPTURES[self.recipe.capture].hold_frames
        self.timing = replace(timing, length_frames=max(timing.length_frames, shortest))

    def draw_motion(self) -> bool:
        """Draw object and motion; tell whether enough of the motion would be observed.

        Raises:
            ValueError: if none of the recipe's objects can move this way.
        """
        self.target = self._draw_target()
        window_s = self.timing.window_frames * CONTROL_DT
        draw = Draw(
            rng=self.rng,
            target=self.target,
            window_s=window_s,
            intercept_s=window_s + self.timing.approach_frames * CONTROL_DT,
            horizon_s=self.timing.path_frames * CONTROL_DT,
            speed_scale=self.recipe.speed_scale,
        )
        self.motion = self.kind.sample(draw)
        return self.motion.launch(self.target).release_s <= max(0.0, window_s - MIN_OBSERVED_S)

    @property
    def fixtures(self) -> tuple[Box, ...]:
        """The static boxes around the motion last drawn."""
        return self.motion.launch(self.target).boxes

    def _draw_target(self) -> TargetObject:
        allowed = [name for name in self.recipe.object_names if name in self.kind.objects()]
        if not allowed:
            raise ValueError(
                f"motion {self.kind.name!r} takes none of the objects {', '.join(self.recipe.object_names)}"
            )
        name = str(self.rng.choice(allowed))
        return OBJECTS[name].sample(self.rng)

    def accept(self, path_w: np.ndarray, home_pos_w: np.ndarray) -> EpisodeSpec | None:
        """Draw the rest and return the episode, or None if the protocol asks for a screen and none can be placed.

        Args:
            path_w: (F, 3) path of the untouched target [m], world.
            home_pos_w: (3,) palm centre at the start [m], world.
        """
        spec = EpisodeSpec(
            seed=self.seed,
            split=self.recipe.split_label,
            motion=self.motion,
            target=self.target,
            appearance=Appearance.sample(self.rng),
            task=draw_instruction(self.recipe.instructions, self.target.name, self.motion.phrase, self.rng),
            protocol=self.recipe.protocol,
            hand=self.recipe.hand,
            window_frames=self.timing.window_frames,
            length_frames=self.timing.length_frames,
            home_pos_w=home_pos_w,
            intercept_frame=self.timing.intercept_frame,
            intercept_pos_w=path_w[self.timing.intercept_frame],
            yaw_rad=float(self.rng.uniform(0, 2 * np.pi)),
            spin_rad_s=float(self.rng.uniform(-MAX_SPIN_RAD_S, MAX_SPIN_RAD_S)),
            oracle_path=path_w,
            fingerprint=self.recipe.fingerprint(),
        )
        spec = randomize_appearance(furnish(spec), self.recipe.appearance)
        return with_screen(spec) if protocol_of(self.recipe.protocol).has_screen else spec
