"""Furniture of an episode: cabinets, shelves, tables, rugs, pictures on the walls, where they hide
nothing.

A box around everything that matters - the target's path, the hand's home, the side camera, fixtures
- stays empty. It is convex, so nothing outside it comes between a camera and a target inside it.
"""

from collections.abc import Sequence
from dataclasses import replace
from operator import gt, lt

import numpy as np

from dynahoi_lerobot.core.conventions import FURNITURE_STREAM
from dynahoi_lerobot.core.numerics import product, quat_to_matrix
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.scene.appearance import Solid, hsv
from dynahoi_lerobot.scene.model import ARENA_HALF_M, FURNITURE_SLOTS, SIDE_CAMERA_POS_M

CLEARANCE_M = 0.35
"""Room around everything that matters."""
ATTEMPTS = 24
Color = tuple[float, float, float]
Part = tuple[tuple[float, float, float], tuple[float, float, float], Color]
"""Lower corner and extent of a box [m], from the middle of the piece's back on the floor; its
color."""


def _cabinet(rng: np.random.Generator, wood: Color, pale: Color, accent: Color) -> list[Part]:
    width = rng.uniform(0.5, 1.6)
    depth = rng.uniform(0.35, 0.6)
    height = rng.uniform(0.4, 1.5)
    body, front = (wood, pale) if rng.random() < 0.5 else (accent, wood)
    door = (0.02, 0.46 * width, height - 0.14)
    return [
        ((0.0, -width / 2, 0.0), (depth, width, height), body),
        ((depth, -0.48 * width, 0.07), door, front),
        ((depth, 0.02 * width, 0.07), door, front),
    ]


def _shelf(rng: np.random.Generator, wood: Color, pale: Color, accent: Color) -> list[Part]:
    width = rng.uniform(0.6, 1.3)
    depth = rng.uniform(0.25, 0.4)
    height = rng.uniform(1.0, 1.9)
    boards = [
        ((0.0, -width / 2, z), (depth, width, 0.04), wood)
        for z in np.linspace(0.05, height - 0.04, 3).tolist()
    ]
    books = ((0.05, -0.4 * width, boards[1][0][2] + 0.04), (0.6 * depth, 0.4 * width, 0.22), accent)
    sides = [((0.0, y, 0.0), (depth, 0.04, height), wood) for y in (-width / 2, width / 2 - 0.04)]
    return [*boards, *sides, books]


def _table(rng: np.random.Generator, wood: Color, pale: Color, accent: Color) -> list[Part]:
    width = rng.uniform(0.8, 1.6)
    depth = rng.uniform(0.5, 0.9)
    height = rng.uniform(0.45, 0.8)
    legs = [
        ((x, y, 0.0), (0.06, 0.06, height), pale)
        for x in (0.03, depth - 0.09)
        for y in (-width / 2 + 0.03, width / 2 - 0.09)
    ]
    return [*legs, ((0.0, -width / 2, height), (depth, width, 0.05), wood)]


def _crate(rng: np.random.Generator, wood: Color, pale: Color, accent: Color) -> list[Part]:
    size = rng.uniform(0.25, 0.6)
    color = accent if rng.random() < 0.6 else pale
    return [((0.0, -size / 2, 0.0), (rng.uniform(0.25, 0.6), size, rng.uniform(0.2, 0.6)), color)]


def _picture(rng: np.random.Generator, wood: Color, pale: Color, accent: Color) -> list[Part]:
    width = rng.uniform(0.5, 1.5)
    height = rng.uniform(0.4, 1.0)
    low = rng.uniform(0.9, 1.5)
    frame = ((0.0, -width / 2, low), (0.04, width, height), wood)
    return [
        frame,
        ((0.04, 0.06 - width / 2, low + 0.06), (0.01, width - 0.12, height - 0.12), accent),
    ]


def _rug(rng: np.random.Generator, wood: Color, pale: Color, accent: Color) -> list[Part]:
    width = rng.uniform(1.2, 2.6)
    depth = rng.uniform(1.0, 2.0)
    color = accent if rng.random() < 0.5 else pale
    return [((0.0, -width / 2, 0.0), (depth, width, 0.012), color)]


PIECES = (_cabinet, _shelf, _table, _crate, _picture, _rug)
"""Each draws one piece in the colors of the episode's wood, of what is pale and of what stands
out."""
ON_THE_WALL = (_picture,)


def furnish(spec: EpisodeSpec) -> EpisodeSpec:
    """Return the episode with furniture and a sleeve, drawn from random numbers of its own."""
    rng = np.random.default_rng([FURNITURE_STREAM, spec.seed])
    wood = hsv(rng.uniform(0.04, 0.11), rng.uniform(0.3, 0.65), rng.uniform(0.25, 0.75))
    pale = hsv(rng.random(), rng.uniform(0.0, 0.15), rng.uniform(0.3, 0.95))
    accent = hsv(rng.random(), rng.uniform(0.3, 0.9), rng.uniform(0.35, 0.9))
    sleeve_rgb = hsv(rng.random(), rng.uniform(0.0, 0.6), rng.uniform(0.15, 0.7))
    furniture = _place_pieces(rng, (wood, pale, accent), _kept_free(spec))
    return replace(
        spec, appearance=replace(spec.appearance, furniture=furniture, sleeve_rgb=sleeve_rgb)
    )


def _place_pieces(
    rng: np.random.Generator, colors: tuple[Color, Color, Color], free: list[np.ndarray]
) -> tuple[Solid, ...]:
    """Boxes of pieces that overlap neither ``free`` boxes (2, 3) [m], lower and upper corner, nor
    each other.

    Half of the slots are filled before the hand, where its own camera looks, then half behind it,
    where the side camera does.
    """
    placed: list[Solid] = []
    taken: list[Sequence[Sequence[float]]] = [box.tolist() for box in free]
    for ahead, slots in ((1.0, FURNITURE_SLOTS // 2), (-1.0, FURNITURE_SLOTS)):
        for _ in range(ATTEMPTS):
            piece = PIECES[rng.integers(len(PIECES))]
            parts = _place(piece(rng, *colors), rng, ahead, on_wall=piece in ON_THE_WALL)
            low = [min(one.pos_w[axis] - one.half_size[axis] for one in parts) for axis in range(3)]
            high = [
                max(one.pos_w[axis] + one.half_size[axis] for one in parts) for axis in range(3)
            ]
            inside = max(map(abs, (*low[:2], *high[:2]))) <= ARENA_HALF_M + 1e-6
            if (
                inside
                and len(placed) + len(parts) <= slots
                and all(_apart((low, high), box) for box in taken)
            ):
                placed += parts
                taken.append((low, high))
            if len(placed) == slots:
                break
    return tuple(placed)


def _apart(one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]) -> bool:
    """Whether two boxes, (2, 3) lower and upper corner, do not even touch."""
    (low, high), (other_low, other_high) = one, other
    return any(map(gt, low, other_high)) or any(map(lt, high, other_low))


def _place(
    parts: list[Part], rng: np.random.Generator, ahead: float, *, on_wall: bool
) -> list[Solid]:
    """Turn a piece's back to a wall, at it or before it: left, right, or the one ahead, 1, or
    behind, -1.
    """
    wall = rng.choice(3, p=(0.6, 0.2, 0.2))
    away = 0.0 if on_wall or rng.random() < 0.3 else rng.uniform(0.0, 4.0)
    along = rng.uniform(-4.5, 4.5) if wall == 0 else rng.uniform(1.0, 5.5)
    solids = []
    for corner, extent, rgb in parts:
        deep, wide, tall = (length / 2 for length in extent)
        x = corner[0] + deep
        y = corner[1] + wide
        z = corner[2] + tall
        if wall == 0:
            pos = (ARENA_HALF_M - away - x, along + y, z)
            size = (deep, wide, tall)
        else:
            side = 1.0 if wall == 1 else -1.0
            pos = (along + y, side * (ARENA_HALF_M - away - x), z)
            size = (wide, deep, tall)
        solids.append(Solid("box", size, (ahead * pos[0], pos[1], pos[2]), rgb))
    return solids


def _kept_free(spec: EpisodeSpec) -> list[np.ndarray]:
    """Boxes (2, 3) [m], lower and upper corner: all that cameras and target do, and each
    fixture.
    """
    home = spec.home_pos_w
    points = np.vstack([spec.target_path_w, home, home + SIDE_CAMERA_POS_M])
    boxes = [np.array([points.min(axis=0), points.max(axis=0)])]
    for box in spec.motion.launch(spec.target).boxes:
        reach = product(
            np.abs(quat_to_matrix(np.asarray(box.quat, float))), np.asarray(box.half_size)
        )
        boxes.append(np.array([box.pos - reach, box.pos + reach]))
    margin = np.array([[-CLEARANCE_M], [CLEARANCE_M]])
    return [box + margin for box in boxes]
