"""EpisodeSpecs from a recipe and seeds: candidates are redrawn until the hand can observe and reach
the target.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.protocols import PROTOCOLS
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.motions import MOTIONS, Draw, Motion, PrescribedMotion, Retimed
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from dynahoi_lerobot.sampling.accepted import accepted_attempts
from dynahoi_lerobot.sampling.fingerprint import recipe_code
from dynahoi_lerobot.sampling.homes import choose_home, draw_directions, find_homes, in_arena
from dynahoi_lerobot.sampling.randomization import randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.salt import salt_words, stream_label
from dynahoi_lerobot.sampling.target_path import RollAhead
from dynahoi_lerobot.sampling.timing import Timing, draw_timing
from dynahoi_lerobot.scene.appearance import Appearance
from dynahoi_lerobot.scene.furniture import furnish
from dynahoi_lerobot.scene.screen import with_screen

MAX_ATTEMPTS = 400
ATTEMPTS_PER_TIMING = 30
"""After so many motions that did not fit, duration and travel are drawn again as well."""
MIN_OBSERVED_S = 0.25
"""A target that is released must be seen moving for this long before control starts."""
MAX_SPIN_RAD_S = 2.0
MAX_SEED = 2**63 - 1
"""Datasets and results store seeds as int64."""
REVEALING = "Catch the {object} that is {phrase}."
NEUTRAL = "Catch the moving {object}."


def sample_specs(recipe: Recipe, seeds: Sequence[int], *, threads: int = 1) -> list[EpisodeSpec]:
    """Return the episodes of ``seeds``, in order.

    Each is a function of (recipe, seed) alone, whatever else is sampled in the same call: its
    motion, object and home are redrawn from the seed's own random numbers until the target can be
    observed and reached. Kinds of motion take turns: seed s has ``recipe.motion_names[s %
    len(recipe.motion_names)]``.

    Args:
        recipe: what to draw from.
        seeds: of the episodes, not negative.
        threads: for rolling targets ahead; the result does not depend on it.

    Raises:
        ValueError: for a negative seed, or if no motion ever fits (the message names motion and
            seed).
    """
    attempts = accepted_attempts(recipe)
    known = {i: Candidate(recipe, seed) for i, seed in enumerate(seeds) if seed in attempts}
    for candidate in known.values():
        candidate.skip(attempts[candidate.seed] - 1)
    specs = _attempt(RollAhead(recipe.rules.hand_name, threads), known)
    others = [i for i in range(len(seeds)) if i not in specs]
    found = search(recipe, [seeds[i] for i in others], threads=threads)
    specs |= {i: spec for i, (_, spec) in zip(others, found, strict=True)}
    return [specs[i] for i in range(len(seeds))]


def search(
    recipe: Recipe, seeds: Sequence[int], *, threads: int = 1
) -> list[tuple[Candidate, EpisodeSpec]]:
    """Return what ``sample_specs`` returns, with the candidates that were accepted, each tried from
    the first attempt on.

    Arguments and errors are those of ``sample_specs``.
    """
    pending = {i: Candidate(recipe, seed) for i, seed in enumerate(seeds)}
    ahead = RollAhead(recipe.rules.hand_name, threads)
    found: dict[int, tuple[Candidate, EpisodeSpec]] = {}
    for _ in range(MAX_ATTEMPTS):
        specs = _attempt(ahead, pending)
        found |= {i: (pending.pop(i), spec) for i, spec in specs.items()}
        if not pending:
            return [found[i] for i in range(len(seeds))]
    failed = next(iter(pending.values()))
    raise ValueError(
        f"motion {failed.kind.name!r} never came into reach and view for seed {failed.seed}"
    )


def sample_spec(recipe: Recipe, seed: int) -> EpisodeSpec:
    """Return the episode of one seed; see ``sample_specs``."""
    return sample_specs(recipe, [seed])[0]


class Candidate:
    """One episode under construction. Every draw comes from ``rng``, which nothing but recipe and
    seed decides.

    Attributes:
        recipe, seed: they determine the episode.
        kind: its kind of motion; kinds take turns with the seed.
        rng: the episode's random numbers.
        attempts: how often motion and object have been drawn.
        timing, motions, target: what was last drawn; unset before the first ``draw``. One motion
            for each of the recipe's path speeds: what is accepted or refused is an episode with all
            its twins.
    """

    attempts = 0
    timing: Timing
    motions: list[Motion]
    target: TargetObject

    def __init__(self, recipe: Recipe, seed: int) -> None:
        """Begin before the first draw of a seed.

        Raises:
            ValueError: if the seed is negative or too large to be stored, or of the recipe's salt
                only a hash is known.
        """
        if not 0 <= seed <= MAX_SEED:
            raise ValueError(f"a seed must be 0 to {MAX_SEED}, got {seed}")
        names = recipe.motion_names
        self.recipe = recipe
        self.seed = seed
        self.kind = MOTIONS[names[seed % len(names)]]
        stream = zlib.crc32(recipe.split_definition.stream.encode())
        self.rng = np.random.default_rng([stream, seed, *salt_words(recipe.salt)])

    def draw(self) -> bool:
        """Draw object and motion, and in every ``ATTEMPTS_PER_TIMING``-th attempt the timing; tell
        whether enough of the motion would be observed.

        Raises:
            ValueError: if none of the recipe's objects can move this way.
        """
        if self.attempts % ATTEMPTS_PER_TIMING == 0:
            self.timing = self._draw_timing()
        self.attempts += 1
        self.target = self._draw_target()
        split = self.recipe.split_definition
        window_s = self.timing.window_frames * CONTROL_DT
        fastest = split.path_speeds[-1]
        intercept_s = window_s + self.timing.approach_frames * CONTROL_DT
        draw = Draw(
            rng=self.rng,
            target=self.target,
            window_s=fastest * window_s,
            intercept_s=fastest * intercept_s,
            horizon_s=fastest * self.timing.path_frames * CONTROL_DT,
            speed_scale=split.speed_scale,
        )
        motion = self.kind.sample(draw)
        self.motions = [motion]
        if fastest != 1.0 and isinstance(motion, PrescribedMotion):
            self.motions = [
                Retimed(motion, speed, intercept_s, draw.intercept_s) for speed in split.path_speeds
            ]
        return motion.launch(self.target).release_s <= max(0.0, window_s - MIN_OBSERVED_S)

    def skip(self, attempts: int) -> None:
        """Draw what is drawn in attempts that do not fit."""
        for _ in range(attempts):
            if self.draw():
                draw_directions(self.rng)

    @property
    def fixtures(self) -> tuple[Box, ...]:
        """The static boxes around the motion last drawn."""
        return self.motions[0].launch(self.target).boxes

    def _draw_timing(self) -> Timing:
        """Draw duration and travel, and leave the capture rule the frames it needs after the
        intercept.
        """
        timing = draw_timing(self.kind.name, self.recipe.rules.protocol, self.rng)
        shortest = timing.intercept_frame + 1 + self.recipe.rules.capture_rule.hold_frames
        return replace(timing, length_frames=max(timing.length_frames, shortest))

    def _draw_target(self) -> TargetObject:
        allowed = [name for name in self.recipe.object_names if self.kind.suits(OBJECTS[name])]
        if not allowed:
            raise ValueError(
                f"motion {self.kind.name!r} takes none of the objects "
                f"{', '.join(self.recipe.object_names)}"
            )
        name = str(self.rng.choice(allowed))
        return OBJECTS[name].sample(self.rng)

    def _draw_instruction(self) -> str:
        style = self.recipe.instructions
        reveals = self.rng.random() < 0.5 if style == "mixed" else style == "reveal"
        return (REVEALING if reveals else NEUTRAL).format(
            object=self.target.name, phrase=self.kind.phrase
        )

    def accept(self, paths_w: Sequence[np.ndarray], home_pos_w: np.ndarray) -> EpisodeSpec | None:
        """Draw the rest and return the episode, or None if the protocol asks for a screen and none
        can be placed.

        Args:
            paths_w: (F, 3) path of the untouched target [m], world, of each of ``motions``.
            home_pos_w: (3,) palm center at the start [m], world.
        """
        hand = HANDS[self.recipe.rules.hand_name]
        spec = EpisodeSpec(
            seed=self.seed,
            split=stream_label(self.recipe.split_definition.stream, self.recipe.salt),
            motion=self.motions[-1],
            target=self.target,
            appearance=Appearance.sample(self.rng),
            task=self._draw_instruction(),
            protocol=self.recipe.rules.protocol,
            hand=self.recipe.rules.hand_name,
            open_joints=hand.open_joints(),
            reference_joints=hand.reference_joints(self.target.grasp_radius_m),
            window_frames=self.timing.window_frames,
            length_frames=self.timing.length_frames,
            home_pos_w=home_pos_w,
            intercept_frame=self.timing.intercept_frame,
            intercept_pos_w=paths_w[-1][self.timing.intercept_frame],
            yaw_rad=float(self.rng.uniform(0, 2 * np.pi)),
            spin_rad_s=float(self.rng.uniform(-MAX_SPIN_RAD_S, MAX_SPIN_RAD_S)),
            target_path_w=paths_w[-1],
            code=recipe_code(self.recipe),
        )
        spec = furnish(spec)  # around the longest path
        spec = randomize_appearance(spec, self.recipe.appearance)
        played = self.recipe.split_definition.path_speeds.index(self.recipe.path_speed)
        spec = replace(spec, motion=self.motions[played], target_path_w=paths_w[played])
        return with_screen(spec) if PROTOCOLS[self.recipe.rules.protocol].has_screen else spec


def _attempt(ahead: RollAhead, pending: dict[int, Candidate]) -> dict[int, EpisodeSpec]:
    """Draw a motion for every pending candidate, roll all targets ahead together; return the
    episodes that fit.
    """
    drawn = {i: candidate for i, candidate in pending.items() if candidate.draw()}
    ahead.place(drawn)
    near = ahead.paths({i: c.timing.intercept_frame + 1 for i, c in drawn.items()})
    homes = {i: find_homes(near[i], c.timing, c.rng) for i, c in drawn.items()}
    reached = {i: candidate for i, candidate in drawn.items() if len(homes[i])}
    whole = ahead.paths({i: candidate.timing.path_frames for i, candidate in reached.items()})
    found = {}
    for i, candidate in reached.items():
        if not all(map(in_arena, whole[i])):
            continue
        home = choose_home(whole[i], candidate.timing, candidate.fixtures, homes[i])
        spec = None if home is None else candidate.accept(whole[i], home)
        if spec is not None:
            found[i] = spec
    return found
