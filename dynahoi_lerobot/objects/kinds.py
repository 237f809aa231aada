"""The objects to catch: each function draws the sizes and positions of one object's solids [m].

`ObjectGeometry` takes the solids, then the grasp radius, the rest height and, of objects that roll,
the roll radius.
"""

import numpy as np

from dynahoi_lerobot.core.numerics import cos, sin, tan
from dynahoi_lerobot.objects.base import ObjectGeometry, object_type
from dynahoi_lerobot.objects.primitives import IDENTITY_QUAT, Primitive

ABOUT_X, ABOUT_Y = (0.5**0.5, 0.5**0.5, 0.0, 0.0), (0.5**0.5, 0.0, 0.5**0.5, 0.0)
"""Quaternions wxyz of a quarter turn about one axis; solids lie along z before it."""


@object_type("ball", rolls=True, slides=True)
def ball(rng: np.random.Generator) -> ObjectGeometry:
    """A ball of radius 2.5 to 4 cm."""
    radius = rng.uniform(0.025, 0.04)
    return ObjectGeometry((Primitive("sphere", (radius,)),), radius, radius, radius)


@object_type("egg")
def egg(rng: np.random.Generator) -> ObjectGeometry:
    """An egg: an ellipsoid of radius 2.4 to 3.2 cm, 1.25 to 1.45 times as tall as wide."""
    radius = rng.uniform(0.024, 0.032)
    height = radius * rng.uniform(1.25, 1.45)
    return ObjectGeometry((Primitive("ellipsoid", (radius, radius, height)),), radius, height)


@object_type("cube", slides=True)
def cube(rng: np.random.Generator) -> ObjectGeometry:
    """A cube with edges of 4.5 to 7 cm."""
    half = rng.uniform(0.0225, 0.035)
    return ObjectGeometry((Primitive("box", (half, half, half)),), half, half)


@object_type("block", slides=True)
def block(rng: np.random.Generator) -> ObjectGeometry:
    """A brick: half extents of 3 to 4.5, 2 to 2.8 and 1.5 to 2.2 cm."""
    size = (rng.uniform(0.03, 0.045), rng.uniform(0.02, 0.028), rng.uniform(0.015, 0.022))
    return ObjectGeometry((Primitive("box", size),), size[1], size[2])


@object_type("cylinder", rolls=True, slides=True)
def cylinder(rng: np.random.Generator) -> ObjectGeometry:
    """A can: a cylinder of radius 2.5 to 3.5 cm and half height 3 to 5 cm."""
    radius = rng.uniform(0.025, 0.035)
    half = rng.uniform(0.03, 0.05)
    return ObjectGeometry((Primitive("cylinder", (radius, half)),), radius, half, radius)


@object_type("disc", slides=True)
def disc(rng: np.random.Generator) -> ObjectGeometry:
    """A disc: a flat cylinder of radius 3 to 4.2 cm and half height 0.8 to 1.2 cm."""
    radius = rng.uniform(0.03, 0.042)
    half = rng.uniform(0.008, 0.012)
    return ObjectGeometry((Primitive("cylinder", (radius, half)),), radius, half)


@object_type("capsule", rolls=True)
def capsule(rng: np.random.Generator) -> ObjectGeometry:
    """A capsule of radius 2.2 to 3.2 cm and half length 1.5 to 3.5 cm between the caps."""
    radius = rng.uniform(0.022, 0.032)
    half = rng.uniform(0.015, 0.035)
    return ObjectGeometry((Primitive("capsule", (radius, half)),), radius, radius + half, radius)


@object_type("bottle")
def bottle(rng: np.random.Generator) -> ObjectGeometry:
    """A bottle: a body of radius 2.4 to 3.2 cm, a neck 0.45 times as wide and a spherical cap."""
    radius = rng.uniform(0.024, 0.032)
    half = rng.uniform(0.035, 0.05)
    neck_radius = 0.45 * radius
    neck_half = 0.35 * half
    shift = 0.12 * half  # puts the center of mass at the origin, within a few per cent
    body = Primitive("cylinder", (radius, half), (0.0, 0.0, -shift))
    neck = Primitive("cylinder", (neck_radius, neck_half), (0.0, 0.0, half - shift + neck_half))
    cap = Primitive("sphere", (1.15 * neck_radius,), (0.0, 0.0, half - shift + 2 * neck_half))
    return ObjectGeometry((body, neck, cap), radius, half + shift)


@object_type("cup", slides=True)
def cup(rng: np.random.Generator) -> ObjectGeometry:
    """A mug: a solid cylinder of radius 2.8 to 3.6 cm and half height 3 to 4.2 cm, with a handle of
    three bars.
    """
    radius = rng.uniform(0.028, 0.036)
    half = rng.uniform(0.03, 0.042)
    body = Primitive("cylinder", (radius, half))
    bar = Primitive("capsule", (0.005, 0.5 * half), (0.0, radius + 0.016, 0.0))
    upper = Primitive("capsule", (0.005, 0.01), (0.0, radius + 0.008, 0.5 * half), ABOUT_X)
    lower = Primitive("capsule", (0.005, 0.01), (0.0, radius + 0.008, -0.5 * half), ABOUT_X)
    return ObjectGeometry((body, bar, upper, lower), radius, half)


@object_type("cone")
def cone(rng: np.random.Generator) -> ObjectGeometry:
    """A cone of base radius 2.8 to 3.8 cm and height 6 to 9 cm, stacked from six cylinders."""
    radius = rng.uniform(0.028, 0.038)
    slice_half = rng.uniform(0.005, 0.0075)
    widths = radius * (1 - np.arange(6) / 6)
    middles = (2 * np.arange(6) + 1) * slice_half  # above the base
    center = float(np.average(middles, weights=widths**2))
    slices = tuple(
        Primitive("cylinder", (float(width), slice_half), (0.0, 0.0, float(middle - center)))
        for width, middle in zip(widths, middles, strict=True)
    )
    return ObjectGeometry(slices, 0.75 * radius, center)  # a cone's radius at its center of mass


@object_type("dumbbell")
def dumbbell(rng: np.random.Generator) -> ObjectGeometry:
    """A dumbbell: two balls of radius 2 to 2.8 cm on a bar, their centers 5 to 8 cm apart."""
    radius = rng.uniform(0.02, 0.028)
    half = rng.uniform(0.025, 0.04)
    bar = Primitive("capsule", (0.4 * radius, half))
    ends = [Primitive("sphere", (radius,), (0.0, 0.0, z)) for z in (-half, half)]
    return ObjectGeometry((bar, *ends), radius, half + radius)


@object_type("jack")
def jack(rng: np.random.Generator) -> ObjectGeometry:
    """A jack: three crossed bars of radius 0.9 to 1.2 cm and half length 3 to 4 cm between the
    caps.
    """
    tube = rng.uniform(0.009, 0.012)
    half = rng.uniform(0.03, 0.04)
    turns = (IDENTITY_QUAT, ABOUT_X, ABOUT_Y)
    bars = tuple(Primitive("capsule", (tube, half), quat=turn) for turn in turns)
    return ObjectGeometry(bars, 0.8 * half, half + tube)


@object_type("ring", slides=True)
def ring(rng: np.random.Generator) -> ObjectGeometry:
    """A ring of eight segments, 2.8 to 3.6 cm from the center to the middle of its 0.8 cm tube."""
    radius = rng.uniform(0.028, 0.036)
    tube = 0.008
    half = float(radius * tan(np.pi / 8))
    segments = []
    for i in range(8):
        x = float(cos(i * np.pi / 4))
        y = float(sin(i * np.pi / 4))
        tangent = (
            0.5**0.5,
            -(0.5**0.5) * x,
            -(0.5**0.5) * y,
            0.0,
        )  # a quarter turn about (-x, -y, 0)
        segments.append(Primitive("capsule", (tube, half), (radius * x, radius * y, 0.0), tangent))
    return ObjectGeometry(tuple(segments), radius + tube, tube)
