"""Render the moving images of the documentation: ``python docs/gallery.py``, a minute on two cores.

``images/catch.gif`` shows two episodes of ``test`` played by ObAct, one caught and one narrowly
missed; ``images/held.gif`` shows three of the contact track, of which it holds two;
``images/<category>.gif`` shows the expert catching a target of every kind of motion,
``images/contact_sheet.jpg`` the start, the control start and the catch of each. All are seen by the
hand's camera. ``images/shadow.jpg`` shows what the Shadow Hand holds from three sides; it needs the
extra `hands`, and OpenGL.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
import torch

from dynahoi_lerobot.core.conventions import CONTROL_HZ, EGO_VIEW
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.evaluate.actors import make_actor
from dynahoi_lerobot.evaluate.gif import BORDERS, phases_of, write_gif
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.rollout.loop import ActionLog, evaluate, replay
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

IMAGES = Path(__file__).parent / "images"
CAUGHT, MISSED = 926, 13  # seeds of `test`
HELD, TOUCHED = (68, 90), 102
PLAYED_PX, SHOWN_PX, HELD_PX, KIND_PX, GRASP_PX = 96, 256, 192, 128, 240
SKIP = 2  # every second frame is shown, at half the rate
AFTER_CATCH, AFTER_MISS = 12, 3  # frames that are shown beyond the catch or the closest approach
BORDER_PX = 4
TILE_PX, LABEL_PX, COLUMNS = 96, 12, 4  # of the contact sheet
JPEG = [
    cv2.IMWRITE_JPEG_QUALITY,
    85,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]


def catch() -> None:
    """Draw what ObAct catches and misses, side by side."""
    recipe = Recipe.of(split="test", image_size=PLAYED_PX)
    episodes = played("checkpoints/obact_standard", recipe, [CAUGHT, MISSED], SHOWN_PX, noise=0)
    write_gif(IMAGES / "catch.gif", side_by_side(episodes), fps=CONTROL_HZ / SKIP)


def contact() -> None:
    """Draw what ObAct grips and what it only touches, side by side."""
    recipe = Recipe.of(split="test", capture="contact", image_size=PLAYED_PX, views=("side",))
    episodes = played("checkpoints/obact_contact", recipe, [*HELD, TOUCHED], HELD_PX, noise=0)
    write_gif(IMAGES / "held.gif", side_by_side(episodes), fps=CONTROL_HZ / SKIP)


def played(
    checkpoint: str, recipe: Recipe, seeds: list[int], size: int, noise: int
) -> list[Episode]:
    """Return what a checkpoint does in episodes, with images of another size; ``noise`` seeds its
    samples.
    """
    specs = sample_specs(recipe, seeds)
    torch.manual_seed(noise)
    episodes = evaluate(WorldBatch(recipe.rules, len(specs)), make_actor(checkpoint), specs)
    logs = {
        episode.meta.seed: ActionLog(episode.meta.seed, episode.given_action)
        for episode in episodes
    }
    shown = list(replay(changed(recipe, {"image_size": size}), [logs[seed] for seed in seeds]))
    for episode in shown:
        print(
            f"{episode.meta.motion}: {episode.stage}, nearest {100 * _nearest(episode)[1]:.1f} cm"
        )
    return shown


def motions() -> None:
    """Draw the expert on one target of every kind that `test` plays, a GIF for each category."""
    for category in CATEGORIES:
        kinds = [
            kind for kind in BENCHMARK.splits["test"].motions if MOTIONS[kind].category == category
        ]
        recipe = Recipe.of(split="test", image_size=KIND_PX)
        specs = [
            sample_specs(replace(recipe, motions=(kind,)), [seed])[0]
            for seed, kind in enumerate(kinds)
        ]
        played = evaluate(
            WorldBatch(recipe.rules, len(specs)),
            EXPERTS[recipe.rules.capture_rule.expert](),
            specs,
            images=True,
        )
        episodes = sorted(played, key=lambda episode: kinds.index(episode.meta.motion))
        write_gif(IMAGES / f"{category}.gif", side_by_side(episodes), fps=CONTROL_HZ / SKIP)


def contact_sheet() -> None:
    """Draw the expert on every kind of motion and every object, in still images."""
    recipe, specs = Recipe.of(split="test", image_size=TILE_PX), []
    unused, kinds = set(recipe.object_names), recipe.motion_names
    suited = {
        kind: [name for name in sorted(unused) if MOTIONS[kind].suits(OBJECTS[name])]
        for kind in kinds
    }
    for number, kind in enumerate(sorted(kinds, key=lambda kind: len(suited[kind]))):
        fresh = [name for name in suited[kind] if name in unused] or suited[kind]
        unused.discard(name := fresh[number % len(fresh)])
        specs += sample_specs(replace(recipe, motions=(kind,), objects=(name,)), [number])
    episodes = list(
        evaluate(
            WorldBatch(recipe.rules, 11),
            EXPERTS[recipe.rules.capture_rule.expert](),
            specs,
            images=True,
        )
    )
    strips = [
        _strip(e)
        for e in sorted(episodes, key=lambda episode: (episode.meta.category, episode.meta.motion))
    ]
    strips += [np.zeros_like(strips[0])] * (-len(strips) % COLUMNS)
    sheet = np.vstack([np.hstack(strips[i : i + COLUMNS]) for i in range(0, len(strips), COLUMNS)])
    cv2.imwrite(str(IMAGES / "contact_sheet.jpg"), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), JPEG)


def robot_hand() -> None:
    """Draw what the expert holds with the Shadow Hand, from three sides."""
    recipe = Recipe.of(
        split="val", capture="contact", hand="shadow", motions=("constant",), objects=("ball",)
    )
    batch = WorldBatch(recipe.rules, 1)
    next(evaluate(batch, EXPERTS["match"](), sample_specs(recipe, [0])))
    model = batch._batch.get_model(0)
    batch._batch.get_data(0, data := mujoco.MjData(model))
    mujoco.mj_forward(model, data)
    images = []
    with mujoco.Renderer(model, GRASP_PX, GRASP_PX) as renderer:
        for azimuth in (150, -60, 30):
            camera = mujoco.MjvCamera()
            camera.lookat[:], camera.distance = data.qpos[batch.scene.hand_qpos[:3]], 0.45
            camera.azimuth, camera.elevation = azimuth, -15
            renderer.update_scene(data, camera)
            images.append(renderer.render())
    cv2.imwrite(
        str(IMAGES / "shadow.jpg"), cv2.cvtColor(np.hstack(images), cv2.COLOR_RGB2BGR), JPEG
    )


def _strip(episode: Episode) -> np.ndarray:
    """Return the label and three moments of an episode, (H, W, 3) uint8 RGB."""
    caught = episode.first_localized or len(episode) - 1
    moments = (0, episode.meta.window_frames, min(caught + 2, len(episode) - 1))
    images = np.hstack([episode.images[EGO_VIEW][frame] for frame in moments])
    strip = cv2.copyMakeBorder(images, LABEL_PX, 4, 0, 4, cv2.BORDER_CONSTANT, value=(0, 0, 0))
    label = f"{episode.meta.motion}, {episode.meta.object}"
    return cv2.putText(
        strip, label, (2, LABEL_PX - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.35, (255, 255, 255)
    )


def side_by_side(episodes: Sequence[Episode]) -> np.ndarray:
    """Return (T, H, n W, 3), the episodes until shortly after the catch; the shorter ones then
    stand still.
    """
    clips = [_bordered(episode)[: _last(episode) : SKIP] for episode in episodes]
    longest = max(map(len, clips))
    return np.concatenate(
        [clip[np.minimum(np.arange(longest), len(clip) - 1)] for clip in clips], axis=2
    )


def _last(episode: Episode) -> int:
    return _nearest(episode)[0] + (AFTER_MISS if episode.first_localized is None else AFTER_CATCH)


def _nearest(episode: Episode) -> tuple[int, float]:
    """Return the frame of the first localization, else of the closest approach, and the distance
    [m] there.
    """
    start = episode.meta.window_frames
    frame = episode.first_localized or start + int(np.argmin(episode.palm_distance_m[start:]))
    return frame, float(episode.palm_distance_m[frame])


def _bordered(episode: Episode) -> np.ndarray:
    """Return (T, H, W, 3), the hand camera's images with a border in the color of each frame's
    phase.
    """
    images = episode.images[EGO_VIEW]
    colors = np.array([BORDERS[phase] for phase in phases_of(episode)], dtype=np.uint8)  # (T, 3)
    frames = np.broadcast_to(colors[:, None, None], images.shape).copy()
    inner = slice(BORDER_PX, -BORDER_PX)
    frames[:, inner, inner] = images[:, inner, inner]
    return frames


if __name__ == "__main__":
    catch()
    contact()
    motions()
    contact_sheet()
    robot_hand()
