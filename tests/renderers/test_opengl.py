"""The OpenGL renderer shows what the ray caster shows, or says in a sentence what it lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.renderers import DEFAULT_RENDERER, opengl
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.batch import WorldBatch

SIZE = 64
LARGEST_DIFFERENCE = 2.0
"""Mean absolute difference of two pictures of plainly painted worlds [grey levels of 255]."""
LEAST_AGREEMENT = 0.99
"""Share of pixels that show the same geom."""


def plain(spec: EpisodeSpec) -> EpisodeSpec:
    """Return the episode without patterns, whose phase differs between the renderers."""
    patterns = ("target_pattern", "floor_pattern", "wall_pattern", "box_pattern")
    return replace(spec, appearance=replace(spec.appearance, **dict.fromkeys(patterns, "plain")))


def batch_of(renderer: str, specs: list[EpisodeSpec]) -> WorldBatch:
    """Return a batch at the end of the fourth frame of ``specs``."""
    batch = make_batch(Recipe(image_size=SIZE, renderer=renderer), len(specs), threads=1)
    batch.reset(range(len(specs)), specs)
    for _ in range(4):
        batch.step(batch.executed)
    return batch


def refusal(batch: WorldBatch) -> str:
    """Return what the batch's renderer says when it cannot draw, empty if it can."""
    try:
        batch.cameras.render()
    except RuntimeError as error:
        return str(error)
    return ""


@pytest.fixture(scope="module")
def pair(specs: list[EpisodeSpec]) -> tuple[WorldBatch, WorldBatch | None]:
    """The same worlds under both renderers; the second is None, after a clear sentence, where there is no OpenGL."""
    chosen = [plain(spec) for spec in specs[:22:3]]
    caster, other = batch_of(DEFAULT_RENDERER, chosen), batch_of("opengl", chosen)
    reason = refusal(other)
    assert not reason or "apt install libegl1" in reason
    return caster, None if reason else other


def test_pictures_agree(pair: tuple[WorldBatch, WorldBatch | None]) -> None:
    caster, other = pair
    if other is not None:
        difference = np.abs(caster.cameras.render().astype(int) - other.cameras.render()).mean(axis=(1, 2, 3))
        assert difference.max() < LARGEST_DIFFERENCE
    assert caster.cameras.render().std(axis=(1, 2, 3)).min() > 5.0  # and they show something


def test_geoms_agree_and_have_their_colours(pair: tuple[WorldBatch, WorldBatch | None]) -> None:
    caster, other = pair
    labels = caster.cameras.segmentation()
    if other is not None:
        assert (labels == other.cameras.segmentation()).mean() > LEAST_AGREEMENT
    pictures = (caster if other is None else other).cameras.render()
    for world, spec in enumerate(caster.specs):
        assert spec is not None
        shown = pictures[world][np.isin(labels[world], caster.scene.target_geoms)]
        if len(shown) > 4:
            shade = np.median(shown, axis=0) / np.linalg.norm(np.median(shown, axis=0))
            wanted = np.asarray(spec.appearance.target_rgb) / np.linalg.norm(spec.appearance.target_rgb)
            assert shade @ wanted > 0.98  # light changes how bright a colour is, not which it is


def test_only_the_worlds_asked_for(pair: tuple[WorldBatch, WorldBatch | None]) -> None:
    batch = pair[1] or pair[0]
    everything, some = batch.cameras.render(), batch.cameras.render(np.array([1, 4]))
    assert (some[[1, 4]] == everything[[1, 4]]).all()
    assert not some[[0, 2, 3]].any()


def test_without_opengl_one_sentence_says_what_to_do(specs: list[EpisodeSpec], monkeypatch: pytest.MonkeyPatch) -> None:
    class Missing:
        def __init__(self, width: int, height: int) -> None:
            raise ImportError("no EGL device")

    monkeypatch.setattr(opengl, "_platform_class", lambda: Missing)
    with pytest.raises(RuntimeError, match=r"no EGL device.*apt install libegl1.*renderer 'tiles'"):
        batch_of("opengl", specs[:1]).cameras.render()
