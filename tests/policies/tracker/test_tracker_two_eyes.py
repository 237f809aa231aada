"""Two eyes: each sees the images of its own camera, and where their lines of sight cross is where the target is."""

from __future__ import annotations

import pytest
import torch
from lerobot_policy_tracker.backbones.two_eyes import TwoEyes
from lerobot_policy_tracker.decisions import Decisions
from lerobot_policy_tracker.eye import N_SIGHTING
from lerobot_policy_tracker.frames import EncodedFrames
from lerobot_policy_tracker.model_card import describe
from lerobot_policy_tracker.track import Track
from tracker_helpers import HAND_FEATURES, make_policy

TINY_EYE = {"channels": 8, "fovea": 12, "embedding": 4}
N_FRAMES = 12
AGE_S = torch.arange(N_FRAMES - 1, -1, -1) * 0.05
TARGET = torch.tensor([0.4, 0.1, -0.1])


def two_eyes() -> TwoEyes:
    torch.manual_seed(0)
    return TwoEyes(16, ego=TINY_EYE, side=TINY_EYE).eval()


def test_each_eye_sees_the_images_of_its_camera():
    eyes, images = two_eyes(), torch.rand(6, 3, 32, 32)
    looks = eyes.look(images)
    for i, eye in enumerate(eyes.eyes):
        torch.testing.assert_close(looks[i::2], eye.look(images[i::2]))
        torch.testing.assert_close(eyes.tokens(looks)[i::2], eye.tokens(looks[i::2]))


def looks_at_target(eyes: TwoEyes, palm: torch.Tensor, factors: tuple[float, float]) -> torch.Tensor:
    """Looks ``(1, T, 2, N_SIGHTING)`` of sure directions and distances that are wrong by a factor each."""
    looks = []
    for eye, factor in zip(eyes.eyes, factors, strict=True):
        place = TARGET - eye.camera.origin(palm)
        wrong = eye.camera.pos + factor * (place - eye.camera.pos)
        scales = torch.tensor([-6.0, -2.0]).expand(*palm.shape[:2], 2)
        looks.append(torch.cat([wrong, eye.camera.seen(wrong), scales], dim=-1))
    return torch.stack(looks, dim=2)


def expected_place(eyes: TwoEyes, n_eyes: int) -> torch.Tensor:
    """Where the track of a target at rest ends, of a hand that moves a little, seen by so many of the eyes."""
    palm = torch.linspace(0, 0.05, N_FRAMES)[None, :, None] * torch.tensor([1.0, 0.0, 0.0])  # (1, T, 3)
    sightings = eyes.sightings(looks_at_target(eyes, palm, (1.15, 0.6)), palm)
    assert sightings.shape == (1, N_FRAMES, 2, N_SIGHTING)
    yes, nothing = torch.ones(1, N_FRAMES, dtype=torch.bool), torch.zeros(1, N_FRAMES, 1)
    frames = EncodedFrames(nothing, nothing, palm, yes, yes, sightings[:, :, :n_eyes], [""])
    decisions = Decisions.among(yes, [range(N_FRAMES)], AGE_S)
    track = Track.of(frames, decisions, eyes.cameras(palm)[:, :, :n_eyes])
    return track.along(torch.zeros(1))[0, 1, 0] + palm[0, -1]


def test_where_two_lines_of_sight_cross_is_where_the_target_is():
    eyes = two_eyes()
    one, both = (float((expected_place(eyes, n) - TARGET).norm()) for n in (1, 2))
    assert both < 0.01
    assert one > 0.04, "one eye believes its distance, which is wrong by 15 %"


def test_another_number_of_cameras_is_refused():
    with pytest.raises(ValueError, match=r"needs 2 cameras, got 1: observation\.images\.ego"):
        make_policy(backbone="two_eyes", backbone_options={"ego": TINY_EYE, "side": TINY_EYE})


def test_an_unknown_camera_is_refused():
    with pytest.raises(ValueError, match="camera must be one of ego, side, got 'top'"):
        make_policy(backbone="eye", backbone_options={"camera": "top"})


def test_the_model_card_names_both_cameras_and_asks_the_environment_for_the_second():
    side = {"observation.images.side": HAND_FEATURES["observation.images.ego"]}
    options = {"ego": TINY_EYE, "side": TINY_EYE}
    policy = make_policy(HAND_FEATURES | side, backbone="two_eyes", backbone_options=options)
    section = describe(policy.config, 1)
    assert "images of `ego` and `side`" in section
    assert "--env.image_size=64 --env.views='[side]'" in section
