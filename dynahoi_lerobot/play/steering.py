"""What a person's pointer, keys and buttons make the hand do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from dynahoi_lerobot.core.conventions import EGO_VIEW, PALM_DOF
from dynahoi_lerobot.scene.pinhole import Pinhole

if TYPE_CHECKING:
    from dynahoi_lerobot.play.live_world import LiveWorld

POINTED_M, DEPTH_M = 0.4, 0.25
"""Distance from the hand's camera at which the pointed place is taken to lie, and how far forward
full depth aims."""


@dataclass(frozen=True)
class Steering:
    """A person's input.

    Attributes:
        x, y: where the pointer is in the image, -1 to 1, to the right and up.
        depth: forward along the line of sight, -1 to 1.
        closed: how far the hand should be closed, 0 to 1.
    """

    x: float = 0.0
    y: float = 0.0
    depth: float = 0.0
    closed: float = 0.0

    @classmethod
    def read(cls, message: Any) -> Self:
        """Return the input that a decoded message holds; numbers out of range are cut.

        Raises:
            ValueError: if it is not a mapping with these four finite numbers.
        """
        if not isinstance(message, dict):
            raise ValueError(f"an input must be an object, got {type(message).__name__}")
        values = [
            value
            for name in ("x", "y", "depth", "closed")
            if isinstance(value := message.get(name), int | float)
        ]
        if len(values) < 4 or not all(abs(value) < 1e6 for value in values):
            raise ValueError("an input needs the finite numbers x, y, depth and closed")
        return cls(*np.clip(values, (-1, -1, -1, 0), 1).tolist())

    def command(self, world: LiveWorld) -> np.ndarray:
        """Return (18,) the command: palm center [m], home frame, and joint angles [rad].

        The palm goes where the pointer points in the plane of the hand's camera, and forward. Under
        ``attach`` closing means the object's reference grasp, since nothing stops the fingers
        there; under ``contact`` the closed hand.
        """
        batch = world.batch
        hand = batch.scene.hand
        camera = Pinhole.of(batch.scene.model, EGO_VIEW)
        pointed_m = POINTED_M * camera.half_view
        way = camera.axes @ [self.x * pointed_m, self.y * pointed_m, -self.depth * DEPTH_M]
        touching = world.recipe.rules.capture_rule.uses_contact_sensors
        closed = hand.closed_joints() if touching else world.spec.reference_joints
        joints = hand.open_joints() * (1 - self.closed) + closed * self.closed
        return np.concatenate([batch.state[0, :PALM_DOF] + way, joints])
