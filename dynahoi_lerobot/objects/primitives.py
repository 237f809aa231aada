"""The solids that objects are made of, and the inertia of several of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.numerics import product, quat_to_matrix

IDENTITY_QUAT = (1.0, 0.0, 0.0, 0.0)
GEOM_TYPES = {"sphere": 2, "capsule": 3, "ellipsoid": 4, "cylinder": 5, "box": 6}
"""MuJoCo's ``mjtGeom`` of each shape: how datasets store it."""


@dataclass(frozen=True)
class Primitive:
    """One solid of an object, in the object's frame.

    Attributes:
        shape: ``sphere``, ``capsule``, ``cylinder``, ``ellipsoid`` or ``box``.
        size: MuJoCo's half-sizes [m]: (radius,) of a sphere, (radius, half length) of a capsule or
            cylinder along z, (x, y, z) of an ellipsoid or a box.
        pos: center [m].
        quat: orientation wxyz.
    """

    shape: str
    size: tuple[float, ...]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = IDENTITY_QUAT

    @property
    def half_size(self) -> tuple[float, float, float]:
        """``size`` padded with zeros to three numbers [m]."""
        x, y, z, *_ = (*self.size, 0.0, 0.0)
        return (x, y, z)


def solid_inertia(primitives: tuple[Primitive, ...], mass_kg: float) -> tuple[float, float, float]:
    """Return the moments of inertia (x, y, z) [kg m^2] of solids of one density about the origin of
    their frame.

    They are the principal ones if the products of inertia vanish, as they do for solids turned by
    right angles or arranged in symmetry. Where solids overlap, their volume counts twice.

    Args:
        primitives: the solids.
        mass_kg: of all of them together.
    """
    volumes = np.array([_volume(p) for p in primitives])
    masses = mass_kg * volumes / volumes.sum()
    total = np.zeros(3)
    for primitive, mass in zip(primitives, masses, strict=True):
        rotation = quat_to_matrix(np.asarray(primitive.quat))
        own = np.diag(
            product(product(rotation, np.diag(mass * _unit_inertia(primitive))), rotation.T)
        )
        offset = np.asarray(primitive.pos)
        total += own + mass * ((offset**2).sum() - offset**2)
    return (float(total[0]), float(total[1]), float(total[2]))


def as_table(primitives: Sequence[Primitive]) -> np.ndarray:
    """Return (S, 11) float32: MuJoCo's geom type, half-sizes [m], position [m] and quaternion wxyz
    of each solid.
    """
    rows = [(GEOM_TYPES[p.shape], *p.half_size, *p.pos, *p.quat) for p in primitives]
    return np.array(rows, np.float32)


def from_table(table: np.ndarray) -> tuple[Primitive, ...]:
    """Return the solids of (S, 11) rows: undoes ``as_table``, up to rounding and zeros behind their
    sizes.

    Raises:
        ValueError: if a geom type is none of ``GEOM_TYPES``.
    """
    shapes = {code: shape for shape, code in GEOM_TYPES.items()}
    unknown = sorted(set(table[:, 0].tolist()) - set(shapes))
    if unknown:
        raise ValueError(f"geom type {unknown[0]:g} is none of {', '.join(map(str, shapes))}")
    return tuple(
        Primitive(shapes[kind], (a, b, c), (x, y, z), (qw, qx, qy, qz))
        for kind, a, b, c, x, y, z, qw, qx, qy, qz in table.tolist()
    )


def extent(primitives: Sequence[Primitive]) -> np.ndarray:
    """Return (3,) how far the solids reach along each axis of their common frame [m], from end to
    end.
    """
    reach = np.stack([_reach(p) for p in primitives])  # (S, 3)
    pos = np.array([p.pos for p in primitives])
    return (pos + reach).max(axis=0) - (pos - reach).min(axis=0)


def _reach(primitive: Primitive) -> np.ndarray:
    """(3,) how far a solid reaches from its center along each axis of the object's frame [m]."""
    turn, (a, b, c) = quat_to_matrix(np.asarray(primitive.quat)), primitive.half_size
    along = np.abs(turn[:, 2])  # of the solid's own axis
    return {
        "sphere": np.full(3, a),
        "capsule": a + b * along,
        "cylinder": b * along + a * np.sqrt(np.maximum(1 - along**2, 0.0)),
        "ellipsoid": np.linalg.norm(turn * (a, b, c), axis=1),
        "box": product(np.abs(turn), np.array([a, b, c])),
    }[primitive.shape]


def _volume(primitive: Primitive) -> float:
    a, b, c = primitive.half_size
    return {
        "sphere": 4 / 3 * np.pi * a**3,
        "capsule": np.pi * a**2 * (2 * b) + 4 / 3 * np.pi * a**3,
        "cylinder": np.pi * a**2 * 2 * b,
        "ellipsoid": 4 / 3 * np.pi * a * b * c,
        "box": 8 * a * b * c,
    }[primitive.shape]


def _unit_inertia(primitive: Primitive) -> np.ndarray:
    """(3,) moments of inertia per unit mass [m^2] about the primitive's own axes."""
    a, b, c = primitive.half_size
    if primitive.shape == "sphere":
        return np.full(3, 0.4 * a**2)
    if primitive.shape == "ellipsoid":
        return 0.2 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    if primitive.shape == "box":
        return np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2]) / 3
    if primitive.shape == "cylinder":
        across = (3 * a**2 + 4 * b**2) / 12
        return np.array([across, across, a**2 / 2])
    return _capsule_unit_inertia(a, b)


def _capsule_unit_inertia(radius: float, half: float) -> np.ndarray:
    """(3,) moments of inertia per unit mass [m^2] of a cylinder of half length ``half`` with two
    hemispherical caps.
    """
    barrel = np.pi * radius**2 * 2 * half
    caps = 4 / 3 * np.pi * radius**3
    mb = barrel / (barrel + caps)
    mc = caps / (barrel + caps)
    axial = mb * radius**2 / 2 + mc * 0.4 * radius**2
    across = mb * (3 * radius**2 + 4 * half**2) / 12 + mc * (
        0.4 * radius**2 + half**2 + 0.75 * half * radius
    )
    return np.array([across, across, axial])
