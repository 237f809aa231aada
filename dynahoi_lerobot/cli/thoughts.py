"""What a policy saw and expected, drawn on the images of the episode that it played: ``dynahoi view
--thoughts``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from dynahoi_lerobot.core.conventions import EGO_VIEW, PALM_DOF
from dynahoi_lerobot.renderers.views import VIEWS
from dynahoi_lerobot.scene.pinhole import Pinhole

if TYPE_CHECKING:
    from dynahoi_lerobot.core.episode import Episode
    from dynahoi_lerobot.world.batch import WorldBatch

WIDTH_PX = 480
STRIP_PX = 48
LEGEND_PX = 20
NEAREST_M = 0.02
"""What is nearer to the camera, or behind it, is not drawn."""
FARTHEST = 40
"""A place outside the image is drawn at most so many halves of it away."""
SIGHTED = (255, 214, 10)
EXPECTED = (64, 200, 255)
MEETING = (255, 70, 160)
BACK = (30, 30, 34)
Pixel = Callable[[np.ndarray], tuple[int, int] | None]
TIMES_S = (0.5, 1.0, 2.4)
"""Times ahead that are written beside the forecast [s]."""


def drawn(episode: Episode, thoughts: Sequence[Any], batch: WorldBatch, view: str) -> np.ndarray:
    """Return (T, H, W, 3) uint8 RGB: a view's images, enlarged, with one thought each, and a strip
    of attention.

    Where a camera sees the target is a cross, where the target is expected are dots, the later the
    smaller, and where the hand is to meet it a ring. The strip shows how much each frame observed
    so far counts.
    """
    images = episode.images[view]
    pages = []
    for k, image in enumerate(images):
        page = cv2.resize(image, (WIDTH_PX, WIDTH_PX), interpolation=cv2.INTER_NEAREST)
        thought = thoughts[min(k, len(thoughts) - 1)]
        _draw_places(page, thought, _camera(batch, view, episode.state[k, :PALM_DOF]))
        pages.append(np.vstack([page, _strip(thought, len(images)), _legend()]))
    return np.stack(pages)


def _camera(batch: WorldBatch, view: str, palm: np.ndarray) -> Pixel:
    """Return what projects a place [m], home frame, to column and row; None if it is not in front
    of the camera.
    """
    name, _ = VIEWS[view]
    camera = Pinhole.of(batch.scene.model, name)
    origin = camera.pos_m + (palm if name == EGO_VIEW else 0.0)  # which the palm carries

    def pixel(place: np.ndarray) -> tuple[int, int] | None:
        right, up, depth = camera.project(place - origin)
        if depth < NEAREST_M:
            return None
        column, row = np.clip([1 + right, 1 - up], -FARTHEST, FARTHEST) * WIDTH_PX / 2
        return int(column), int(row)

    return pixel


def _draw_places(page: np.ndarray, thought: Any, pixel: Pixel) -> None:
    forecast = thought.forecast[0].numpy()
    ahead_s = thought.ahead_s.numpy()
    for place, seconds in reversed(list(zip(forecast, ahead_s, strict=True))):
        at = pixel(place)
        if at is not None:
            cv2.circle(page, at, max(2, round(6 - 2 * seconds)), EXPECTED, -1, cv2.LINE_AA)
            if np.isclose(seconds, TIMES_S, atol=0.06).any():
                _write(page, f"{seconds:.1f} s", (at[0] + 7, at[1] - 5), EXPECTED)
    for place in thought.sighted[0].numpy():
        at = pixel(place)
        if at is not None:
            cv2.drawMarker(page, at, SIGHTED, cv2.MARKER_CROSS, 22, 2, cv2.LINE_AA)
    at = pixel(thought.intercept[0].numpy())
    if at is not None:
        cv2.circle(page, at, 13, MEETING, 2, cv2.LINE_AA)


def _strip(thought: Any, n_frames: int) -> np.ndarray:
    """Return a bar for every frame observed so far, as wide as its share of the episode."""
    strip = np.full((STRIP_PX, WIDTH_PX, 3), BACK, np.uint8)
    weights = thought.attention[0].mean(0).numpy()
    edges = np.linspace(0, WIDTH_PX, max(n_frames, len(weights)) + 1).astype(int)
    for weight, left, right in zip(weights, edges, edges[1:], strict=False):
        top = STRIP_PX - max(1, round(float(weight / weights.max()) * (STRIP_PX - 4)))
        strip[top:, left : max(left + 1, right - 1)] = SIGHTED
    return strip


def _legend() -> np.ndarray:
    legend = np.full((LEGEND_PX, WIDTH_PX, 3), BACK, np.uint8)
    words = (("+ seen", SIGHTED, 6), ("o expected", EXPECTED, 80), ("O meeting", MEETING, 185))
    for word, color, column in (*words, ("bars: weight of each frame", SIGHTED, 280)):
        _write(legend, word, (column, 14), color)
    return legend


def _write(page: np.ndarray, text: str, at: tuple[int, int], color: tuple[int, int, int]) -> None:
    for shade, width in ((BACK, 3), (color, 1)):
        cv2.putText(page, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, shade, width, cv2.LINE_AA)
