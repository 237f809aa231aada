"""Appearance changes pictures and nothing else; each switch is a stream of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.randomization import SWITCHES, randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from tests.world.playing import world

SIZE = 64


def pictures(specs: list[EpisodeSpec], renderer: str = "tiles") -> np.ndarray:
    return world(specs, image_size=SIZE, renderer=renderer).cameras.render().astype(int)


@pytest.fixture(scope="module")
def few(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    return specs[:22:3]


@pytest.mark.parametrize("switch", SWITCHES)
def test_a_switch_changes_what_is_seen_in_every_episode(switch: str, few: list[EpisodeSpec]) -> None:
    varied = [randomize_appearance(spec, [switch]) for spec in few]
    assert all(new.appearance != old.appearance for new, old in zip(varied, few, strict=True))
    assert (np.abs(pictures(varied) - pictures(few)).max(axis=(1, 2, 3)) > 8).mean() > 0.7


@pytest.mark.parametrize("switch", SWITCHES)
def test_switches_do_not_disturb_each_other(switch: str, few: list[EpisodeSpec]) -> None:
    """What a switch sets is the same alone and with all others."""
    for spec in few:
        alone, together = (
            randomize_appearance(spec, [switch]).appearance,
            randomize_appearance(spec, list(SWITCHES)).appearance,
        )
        changed = [name for name, value in vars(alone).items() if value != getattr(spec.appearance, name)]
        assert changed
        assert all(getattr(alone, name) == getattr(together, name) for name in changed)


def test_nothing_but_pictures_changes() -> None:
    plain = next(record(Recipe(image_size=32), [3]))
    varied = next(record(Recipe(image_size=32, appearance=tuple(SWITCHES)), [3]))
    for name in ("state", "action", "target_pose", "target_contacts"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(varied, name))
    assert plain.meta.task == varied.meta.task
    assert np.abs(plain.images["ego"].astype(int) - varied.images["ego"]).mean() > 5


def test_distractors_stand_behind_the_targets_path(few: list[EpisodeSpec]) -> None:
    for spec in few:
        things = randomize_appearance(spec, ["distractors"]).appearance.distractors
        assert 1 <= len(things) <= 4
        assert all(thing.pos_w[0] - max(thing.half_size) > spec.oracle_path[:, 0].max() for thing in things)


def test_translucent_targets_are_blended_with_what_is_behind(few: list[EpisodeSpec]) -> None:
    def seen(alpha: float) -> np.ndarray:
        return pictures([replace(spec, appearance=replace(spec.appearance, target_alpha=alpha)) for spec in few])

    solid, behind = seen(1.0), seen(0.0)
    assert np.abs(seen(0.4) - (0.4 * solid + 0.6 * behind)).max() < 3


def test_highlights_only_brighten_and_opengl_has_them_too(few: list[EpisodeSpec]) -> None:
    shiny = [replace(spec, appearance=replace(spec.appearance, gloss=0.9, light_dir=(0.7, 0.0, -1.0))) for spec in few]
    dull = [replace(spec, appearance=replace(spec.appearance, light_dir=(0.7, 0.0, -1.0))) for spec in few]
    added = pictures(shiny) - pictures(dull)
    assert added.min() >= 0
    assert added.max() > 60
    try:
        theirs = pictures(shiny, "opengl") - pictures(dull, "opengl")
    except RuntimeError:
        return  # no OpenGL here; test_opengl.py looks at what is said
    # OpenGL lights vertices, not pixels, and regards every ray as parallel; so highlights agree roughly
    assert np.corrcoef(added.ravel(), theirs.ravel())[0, 1] > 0.4


def test_unknown_switches_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown appearance 'fog'; known: materials, lights"):
        Recipe(appearance=("fog",))
