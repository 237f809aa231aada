"""Cameras and the eye: their geometry, the fovea, and what the eye learns."""

from pathlib import Path

import pytest
import torch
from lerobot_policy_obact.encoders import ENCODERS, SHIPPED, Eye
from lerobot_policy_obact.eye.pretraining import sighting_loss
from transformers import ConvNextConfig, ConvNextModel, ViTConfig, ViTImageProcessor, ViTModel

from tests.checkpoints import fit
from tests.policies.obact.test_windows import camera


def test_what_is_seen_and_places_are_inverse_and_u_grows_to_the_right_and_v_upwards():
    offset = torch.tensor([[0.1, 0.2, -0.1], [0.5, -0.3, 0.2], [0.02, 0.0, 0.03]])
    torch.testing.assert_close(
        camera().unproject(camera().project(offset)), offset, rtol=1e-4, atol=1e-5
    )
    middle, right, above = camera().project(
        torch.tensor([[0.3, 0.03, 0.21], [0.3, -0.2, 0.21], [0.3, 0.03, 0.4]])
    )
    assert middle[:2].abs().max() < 1e-5
    assert right[0] > 0.2
    assert above[1] > 0.2


def test_the_fovea_shows_the_pixels_around_the_point_it_looks_at():
    eye = Eye(fovea=4).eval()
    image = torch.full((1, 7, 64, 64), 0.5)
    ray = torch.tensor([[2 * 41 / 64 - 1, 1 - 2 * 23 / 64]])

    def with_a_dot(row: int, column: int) -> torch.Tensor:
        dotted = image.clone()
        dotted[:, 1, row, column] = 0.0
        return eye._crop(dotted, ray)

    assert torch.equal(with_a_dot(60, 2), eye._crop(image, ray)), "far from there"
    assert not torch.equal(with_a_dot(22, 40), eye._crop(image, ray))


def squares(n: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Gray images with a red square in each, which is the larger, the nearer it is; and its offsets
    [m].
    """
    generator = torch.Generator().manual_seed(seed)
    images = torch.full((n, 6, 32, 32), 0.5)
    seen = torch.empty(n, 3)
    for i in range(n):
        half = int(torch.randint(1, 4, (), generator=generator))
        x, y = torch.randint(4, 28, (2,), generator=generator).tolist()
        for channel, value in enumerate((1.0, 0.0, 0.0, 1.0, 0.0, 0.0)):
            images[i, channel, y - half : y + half, x - half : x + half] = value
        seen[i] = torch.tensor([2 * x / 32 - 1, 1 - 2 * y / 32, 0.5 - half / 3])
    return images, camera().unproject(seen)


@pytest.mark.slow
def test_it_learns_where_a_square_is_and_says_how_sure_it_is():
    torch.manual_seed(0)
    eye = Eye(channels=8, fovea=12)
    images, offset = squares(128, seed=0)
    fit(eye.parameters(), lambda: sighting_loss(eye, camera(), images, offset).mean(), steps=150)
    images, offset = squares(64, seed=1)
    sighting = eye(images)
    error = (camera().unproject(sighting[:, :3]) - offset).norm(dim=-1)
    assert error.median() < 0.05, "of squares at 0.3 to 0.7 m"
    assert sighting[:, 3].median() < -2, "it knows the direction to a tenth of half the view"


@pytest.mark.parametrize("name", SHIPPED)
def test_eyes_that_ship_load_whole_and_see_nothing_in_a_black_image(name: str):
    eye = Eye(weights=name)
    before = eye.attention.query.weight.clone()
    eye.load_pretrained()
    assert not torch.equal(eye.attention.query.weight, before)
    assert (eye(torch.zeros(1, 6, 32, 32))[0, 3:5] == 5.0).all()


def test_weights_that_are_not_there_are_named(tmp_path: Path):
    with pytest.raises(ValueError, match=r"nothing\.safetensors.*ego_96, side_96"):
        Eye(weights=str(tmp_path / "nothing.safetensors")).load_pretrained()


SMALL_VIT = {
    "hidden_size": 16,
    "num_hidden_layers": 1,
    "num_attention_heads": 2,
    "intermediate_size": 16,
    "image_size": 32,
    "patch_size": 8,
}
SMALL_CONVNEXT = {"hidden_sizes": [8, 16], "depths": [1, 1], "num_stages": 2}


@pytest.mark.parametrize(
    ("kind", "config"),
    [
        (ViTModel, ViTConfig(**SMALL_VIT)),
        (ConvNextModel, ConvNextConfig(**SMALL_CONVNEXT)),
    ],
)
def test_a_vision_tower_gives_a_sighting_and_an_embedding(kind: type, config, tmp_path: Path):
    kind(config).save_pretrained(tmp_path)
    ViTImageProcessor().save_pretrained(tmp_path)
    encoder = ENCODERS["transformers"](embedding=7, name=str(tmp_path))
    encoder.load_pretrained()
    assert encoder(torch.rand(2, 3, 64, 64)).shape == (2, 5 + 7)
