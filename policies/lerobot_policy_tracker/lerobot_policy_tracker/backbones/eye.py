"""ObAct's eye as an encoder of the tracker: it adds a token to every sighting."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from ..eye import N_SIGHTING, Eye
from .base import backbones


@backbones.register("eye")
class EyeBackbone(Eye):
    """An `Eye` with one token per frame; it has the interface of a `Backbone`.

    Args:
        width: token size.
        frozen: train only the layer that makes the tokens.
    """

    reads_text: ClassVar[bool] = False
    locates: ClassVar[bool] = True
    sees_motion: ClassVar[bool] = True
    n_cameras: ClassVar[int | None] = None

    def __init__(
        self,
        width: int,
        *,
        channels: int = 32,
        fovea: int = 20,
        embedding: int = 64,
        camera: str = "ego",
        weights: str = "",
        frozen: bool = True,
    ) -> None:
        super().__init__(
            channels=channels, fovea=fovea, embedding=embedding, camera=camera, weights=weights, frozen=frozen
        )
        self.width = width
        self.token = nn.Linear(self.look_dim(embedding), width)

    @staticmethod
    def look_dim(embedding: int) -> int:
        """Size of what `look` returns per frame."""
        return N_SIGHTING + embedding

    def learned_state(self) -> dict[str, Tensor]:
        """Return the weights of all but the token layer, which belongs to a policy."""
        return {name: value for name, value in self.state_dict().items() if not name.startswith("token.")}

    def look(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Eye.look`."""
        return super().look(images)

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; one token."""
        return self.tokens(self.look(images))

    def tokens(self, looks: Tensor) -> Tensor:
        """Map looks ``(F, L)`` to tokens ``(F, 1, D)``."""
        return self.token(looks)[:, None]

    def sightings(self, looks: Tensor, palm: Tensor) -> Tensor:
        """See `Backbone.sightings`: those in the images of the first camera."""
        first = looks[:, :, :1, :N_SIGHTING]
        carried = palm[:, :, None]
        return torch.cat([first[..., :3] + self.camera.origin(carried) - carried, first[..., 3:]], dim=-1)

    def cameras(self, palm: Tensor) -> Tensor:
        """See `Backbone.cameras`."""
        return self.camera.origin(palm[:, :, None]) + self.camera.pos
