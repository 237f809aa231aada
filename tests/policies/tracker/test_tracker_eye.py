"""The eye: its geometry, its fovea, what it learns and what of it is trained with a policy."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from lerobot_policy_tracker.eye import CAMERAS, sighting_loss
from lerobot_policy_tracker.backbones.eye import EyeBackbone
from safetensors.torch import save_file


@pytest.mark.parametrize("name", CAMERAS)
def test_what_is_seen_and_places_are_inverse(name: str):
    camera = CAMERAS[name]()
    offset = torch.tensor([[0.1, 0.2, -0.1], [0.5, -0.3, 0.2], [0.02, 0.0, 0.03]])
    torch.testing.assert_close(camera.place(camera.seen(offset)), offset, rtol=1e-4, atol=1e-5)


def test_u_grows_to_the_right_and_v_upwards():
    camera = CAMERAS["ego"]()
    right, above = camera.seen(torch.tensor([[0.3, -0.2, 0.0], [0.3, 0.0, 0.3]]))
    middle = camera.seen(torch.tensor([0.3, 0.0, 0.0]))
    assert right[0] > middle[0]
    assert above[1] > middle[1]


def test_the_fovea_shows_the_pixels_around_the_point_it_looks_at():
    eye = EyeBackbone(16, fovea=4)
    pixels = torch.arange(64.0 * 64).reshape(1, 1, 64, 64).expand(1, 7, -1, -1) / 4096
    column, row = 40, 24  # the fovea's middle lies between pixels 39 and 40, and between rows 23 and 24
    centre = torch.tensor([[2 * column / 64 - 1, 1 - 2 * row / 64]])
    crop = eye._crop(pixels, centre) * eye.pixel_std + eye.pixel_mean
    torch.testing.assert_close(crop, pixels[:, :, row - 2 : row + 2, column - 2 : column + 2], rtol=0, atol=1e-5)


def dots(n: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Grey pictures with a red square in each, which is the larger, the nearer it is; and its offsets."""
    generator, eye = torch.Generator().manual_seed(seed), EyeBackbone(16)
    images = torch.full((n, 3, 32, 32), 0.5)
    camera = torch.empty(n, 3)
    for i in range(n):
        half = int(torch.randint(1, 4, (), generator=generator))
        x, y = torch.randint(4, 28, (2,), generator=generator).tolist()
        images[i, 0, y - half : y + half, x - half : x + half] = 1.0
        images[i, 1:, y - half : y + half, x - half : x + half] = 0.0
        camera[i] = torch.tensor([2 * x / 32 - 1, 1 - 2 * y / 32, 0.5 - half / 3])
    return images, eye.camera.place(camera)


@pytest.mark.slow
def test_it_learns_where_a_square_is_and_says_how_sure_it_is():
    torch.manual_seed(0)
    eye = EyeBackbone(16, channels=8, fovea=12, embedding=4, frozen=False)
    optimizer = torch.optim.AdamW(eye.parameters(), lr=3e-3)
    images, offset = dots(256, seed=0)
    for _ in range(150):
        optimizer.zero_grad()
        loss = sighting_loss(eye, images, offset).mean()
        loss.backward()
        optimizer.step()
    images, offset = dots(64, seed=1)
    looks = eye.look(images)
    error = (looks[:, :3] - offset).norm(dim=-1)
    assert error.median() < 0.05, "of squares at 0.3 to 0.7 m"
    assert looks[:, 6].median() < -2, "it knows the direction to a tenth of half the view"


def test_a_policy_trains_only_the_tokens_of_a_frozen_eye(tmp_path: Path):
    trained = EyeBackbone(16)
    save_file(trained.learned_state(), tmp_path / "eye.safetensors")
    eye = EyeBackbone(32, weights=str(tmp_path / "eye.safetensors"))
    assert not torch.equal(eye.heat.weight, trained.heat.weight)
    eye.load_pretrained()
    torch.testing.assert_close(eye.heat.weight, trained.heat.weight, rtol=0, atol=0)
    assert {name for name, weight in eye.named_parameters() if weight.requires_grad} == {"token.weight", "token.bias"}


def test_weights_that_are_not_there_are_named(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.safetensors"):
        EyeBackbone(16, weights=str(tmp_path / "nothing.safetensors")).load_pretrained()
