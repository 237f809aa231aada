"""The gallery's pictures: the expert catching, drawn by the project's own renderer."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from docs.extensions.gallery.concept_plots import draw_concepts
from docs.extensions.gallery.metric_plots import draw_metrics
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.evaluate.gif import phases_of, write_gif
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.renderers.camera_views import EXTRA_VIEWS, VIEWS
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS, randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

SIZE_PX = 128
SKIP = 2
"""Every second frame is shown, at half the rate."""
ANY_OBJECT_KIND = "constant"
"""A motion that every object can make."""
APPEARANCE_KINDS = ("lob", "planar", "struck", "vertical_circle")
FRAMES_AFTER_CATCH = 12
HERO_FRAMES, HERO_COLUMNS = 44, 4


def draw_missing(folder: Path) -> None:
    """Draw all pictures below ``folder``, unless those that are there are of the same code."""
    stamp, digest = folder / ".drawn", _digest()
    if stamp.is_file() and stamp.read_text() == digest:
        return
    for draw in (draw_motions, draw_objects, draw_hands, draw_views, draw_appearances, draw_metrics, draw_concepts):
        draw(folder)
    stamp.write_text(digest)


def _digest() -> str:
    """Return what changes with the code that decides the pictures."""
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    return code_fingerprint() + hashlib.sha256(sources).hexdigest()[:16]


def draw_motions(folder: Path) -> None:
    """Draw each kind of motion from the hand's camera and from the side, and all categories for the front page."""
    specs = [_spec(motion=kind, seed=seed) for seed, kind in enumerate(MOTIONS.names())]
    episodes = {episode.meta.motion: episode for episode in _played(specs)}
    for kind, episode in episodes.items():
        _write(folder / "motions" / kind, episode)
    shown = {episode.meta.category: episode for episode in episodes.values()}
    _write_hero(folder / "catching.gif", [shown[category] for category in CATEGORIES])


def draw_objects(folder: Path) -> None:
    """Draw each object being caught."""
    for episode in _played([_spec(object=name, seed=seed) for seed, name in enumerate(OBJECTS.names())]):
        _write(folder / "objects" / episode.meta.object, episode)


def draw_hands(folder: Path) -> None:
    """Draw each hand catching the same target; one whose model is not on this machine has no picture."""
    spec = _spec(motion=ANY_OBJECT_KIND)
    for name in filter(can_be_drawn, HANDS.names()):
        _write(folder / "hands" / name, next(_played([spec], hand=name)))


def can_be_drawn(hand: str) -> bool:
    """Tell whether this machine has the hand's model, which may come from elsewhere."""
    try:
        HANDS[hand]().add_to(mujoco.MjSpec())
    except ValueError:
        return False
    return True


def draw_views(folder: Path) -> None:
    """Draw one episode in every view."""
    (episode,) = _played([_spec(motion="lob")], views=EXTRA_VIEWS)
    for view in VIEWS:
        _write(folder / "views" / view, episode, (view,))


def draw_appearances(folder: Path) -> None:
    """Draw the same moments as they are by default, above, and with each randomisation, below."""
    specs = [_spec(motion=kind, seed=seed) for seed, kind in enumerate(APPEARANCE_KINDS)]
    default = _first_pictures(specs)
    for name in RANDOMIZATIONS:
        path = folder / "appearances" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        changed = _first_pictures([randomize_appearance(spec, [name]) for spec in specs])
        Image.fromarray(np.vstack([np.hstack(default), np.hstack(changed)])).save(path, optimize=True)


def _spec(motion: str = "", object: str = "", seed: int = 0) -> EpisodeSpec:
    """Return an episode of a split that has the motion or the object; another seed has another room."""
    noun, name = ("motion", motion) if motion else ("object", object)
    splits = BENCHMARK.splits_with(noun, name)
    split = "test" if "test" in splits or not splits else splits[0]
    recipe = Recipe(split=split, motions=(motion or ANY_OBJECT_KIND,), objects=(object,) if object else ())
    return sample_specs(recipe, [seed])[0]


def _played(specs: list[EpisodeSpec], *, hand: str = "", views: tuple[str, ...] = ("side",)) -> Iterator[Episode]:
    """Yield the expert's episodes with images."""
    recipe = Recipe(split="test", image_size=SIZE_PX, views=views, hand=hand)
    return evaluate(make_batch(recipe, len(specs)), EXPERTS[recipe.expert](), specs, images=True)


def _write(stem: Path, episode: Episode, views: Iterable[str] = ("ego", "side")) -> None:
    """Write an episode as a GIF, its views side by side, and the moment of the catch as a PNG."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    frames = np.concatenate([episode.images[view] for view in views], axis=2)  # (T, H, n W, 3)
    last = _catch(episode) + FRAMES_AFTER_CATCH
    write_gif(
        stem.with_suffix(".gif"), frames[:last:SKIP], fps=CONTROL_HZ / SKIP, phases=phases_of(episode)[:last:SKIP]
    )
    picture = episode.images[next(iter(views))][min(_catch(episode) + SKIP, len(episode) - 1)]
    Image.fromarray(picture).save(stem.with_suffix(".png"), optimize=True)


def _write_hero(path: Path, episodes: list[Episode]) -> None:
    """Write one GIF of several episodes that are caught at the same moment."""
    clips = np.stack([_around_catch(episode) for episode in episodes])  # (N, T, H, W, 3)
    rows = [np.concatenate(list(clips[i : i + HERO_COLUMNS]), axis=2) for i in range(0, len(clips), HERO_COLUMNS)]
    write_gif(path, np.concatenate(rows, axis=1), fps=CONTROL_HZ / SKIP)


def _around_catch(episode: Episode) -> np.ndarray:
    """Return the frames that end soon after the catch; the first and the last one stand still where there are none."""
    end = _catch(episode) + FRAMES_AFTER_CATCH
    return episode.images["ego"][np.clip(np.arange(end - HERO_FRAMES, end, SKIP), 0, len(episode) - 1)]


def _catch(episode: Episode) -> int:
    return len(episode) - 1 if episode.first_localized is None else episode.first_localized


def _first_pictures(specs: list[EpisodeSpec]) -> np.ndarray:
    """Return (N, H, W, 3), how the hand's camera sees each episode at its start."""
    batch = make_batch(replace(Recipe(split="test"), image_size=SIZE_PX), len(specs))
    batch.reset(range(len(specs)), specs)
    return batch.cameras.render()
