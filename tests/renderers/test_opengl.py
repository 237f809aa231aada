"""The OpenGL renderer shows what the ray caster shows; without OpenGL it says in a sentence what to do."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.renderers import opengl
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.batch import WorldBatch

SIZE = 64


def opengl_is_missing() -> bool:
    """Tell whether MuJoCo finds no OpenGL on this machine."""
    try:
        context = opengl._platform_class()(16, 16)
        context.make_current()
        context.free()
    except (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError):
        return True
    return False


needs_opengl = pytest.mark.skipif(
    opengl_is_missing(), reason="no OpenGL on this machine; Debian: apt install libegl1 libgl1-mesa-dri"
)
LARGEST_DIFFERENCE = 2.0
"""Mean absolute difference of two images of plainly painted worlds [grey levels of 255]."""
LEAST_AGREEMENT = 0.99
"""Share of pixels that show the same geom."""


def plain(spec: EpisodeSpec) -> EpisodeSpec:
    """Return the episode without patterns, whose phase differs between the renderers."""
    patterns = ("target_pattern", "floor_pattern", "wall_pattern", "box_pattern")
    return replace(spec, appearance=replace(spec.appearance, **dict.fromkeys(patterns, "plain")))


def batch_of(renderer: str, specs: list[EpisodeSpec]) -> WorldBatch:
    """Return a batch at the end of the fourth frame of ``specs``."""
    batch = WorldBatch(Recipe(image_size=SIZE, renderer=renderer), len(specs), threads=1)
    batch.reset(range(len(specs)), specs)
    for _ in range(4):
        batch.step(batch.executed)
    return batch


@pytest.fixture(scope="module")
def ray_casting(specs: list[EpisodeSpec]) -> WorldBatch:
    """Plainly painted worlds under the ray caster, with the light that OpenGL has."""
    return batch_of("flat", [plain(spec) for spec in specs[:22]])


@pytest.fixture(scope="module")
def opengl_worlds(specs: list[EpisodeSpec]) -> WorldBatch:
    """The same worlds under OpenGL."""
    return batch_of("opengl", [plain(spec) for spec in specs[:22]])


@needs_opengl
def test_images_agree(ray_casting: WorldBatch, opengl_worlds: WorldBatch) -> None:
    difference = np.abs(ray_casting.cameras.render().astype(int) - opengl_worlds.cameras.render()).mean(axis=(1, 2, 3))
    assert difference.max() < LARGEST_DIFFERENCE
    assert opengl_worlds.cameras.render().std(axis=(1, 2, 3)).min() > 5.0, "they show something"


@needs_opengl
def test_geoms_agree_and_have_their_colours(ray_casting: WorldBatch, opengl_worlds: WorldBatch) -> None:
    labels, images = opengl_worlds.cameras.segmentation(), opengl_worlds.cameras.render()
    assert (labels == ray_casting.cameras.segmentation()).mean() > LEAST_AGREEMENT
    compared = 0
    for world, spec in enumerate(opengl_worlds.specs):
        assert spec is not None
        shown = images[world][np.isin(labels[world], opengl_worlds.scene.target_geoms)]
        if len(shown) > 4:
            color = np.median(shown, axis=0) / np.linalg.norm(np.median(shown, axis=0))
            wanted = np.asarray(spec.appearance.target_rgb) / np.linalg.norm(spec.appearance.target_rgb)
            assert color @ wanted > 0.98, "light changes the brightness of a colour, not its hue"
            compared += 1
    assert compared >= 12


@needs_opengl
def test_depth_agrees(ray_casting: WorldBatch, opengl_worlds: WorldBatch) -> None:
    ours, theirs = ray_casting.cameras.depth(), opengl_worlds.cameras.depth()
    assert (theirs > 0.0).any()
    assert (np.abs(ours - theirs) > 0.02 * ours + 0.005).mean() < 0.02


@needs_opengl
def test_only_the_worlds_asked_for(opengl_worlds: WorldBatch) -> None:
    everything, some = opengl_worlds.cameras.render(), opengl_worlds.cameras.render(np.array([1, 4]))
    assert (some[[1, 4]] == everything[[1, 4]]).all()
    assert not some[[0, 2, 3]].any()


def test_without_opengl_one_sentence_says_what_to_do(specs: list[EpisodeSpec], monkeypatch: pytest.MonkeyPatch) -> None:
    class Missing:
        def __init__(self, width: int, height: int) -> None:
            raise ImportError("no EGL device")

    monkeypatch.setattr(opengl, "_platform_class", lambda: Missing)
    with pytest.raises(RuntimeError, match=r"no EGL device.*apt install libegl1.*renderer 'tiles'"):
        batch_of("opengl", specs[:1]).cameras.render()
