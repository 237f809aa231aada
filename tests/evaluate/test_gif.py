"""GIFs: size, timing, borders, captions, and what is refused."""

import io

import numpy as np
from PIL import Image, ImageSequence

from dynahoi_lerobot.evaluate.gif import (
    BORDER_PX,
    BORDERS,
    CAPTION_PX,
    encode_gif,
)

FRAMES = np.random.default_rng(0).integers(0, 255, (5, 12, 16, 3), np.uint8)


def pages(data: bytes) -> list[Image.Image]:
    with Image.open(io.BytesIO(data)) as gif:
        return [page.convert("RGB").copy() for page in ImageSequence.Iterator(gif)]


def total_ms(data: bytes) -> int:
    return sum(page.info["duration"] for page in pages(data))


def test_frames_keep_their_number_and_pace_under_a_border_of_the_phase_and_a_caption_that_fits():
    names = ["observing", "observing", "acting", "localized", "localized"]
    data = encode_gif(FRAMES, phases=names, caption="wide " * 50)
    shown = pages(data)
    assert total_ms(data) == 5 * 50
    for page, name in zip(shown, names, strict=True):
        assert page.size == (16 + 2 * BORDER_PX, 12 + 2 * BORDER_PX + CAPTION_PX)
        assert np.abs(np.array(page.getpixel((0, 0))) - BORDERS[name]).max() < 12
    assert data == encode_gif(FRAMES, phases=names, caption="wide " * 20_000)
    (plain,) = pages(encode_gif(FRAMES[:1] // 255, caption="x"))
    assert np.asarray(plain)[12:].max() > 150, "the text must be visible"


def test_enlarged_pixels_stay_crisp():
    pixels = np.asarray(pages(encode_gif(FRAMES[:1], min_width=33))[0])
    assert pixels.shape == (36, 48, 3)
    assert (pixels[0:3, 0:3] == pixels[0, 0]).all()


def test_what_stands_still_keeps_its_colors_and_is_stored_once():
    still = np.random.default_rng(1).integers(0, 255, (1, 64, 64, 3), np.uint8).repeat(20, axis=0)
    moving = still.copy()
    for frame, image in enumerate(moving):
        image[8:16, 2 * frame : 2 * frame + 8] = (250, 250, 10 * frame)
    first, *rest = (np.asarray(page)[20:] for page in pages(encode_gif(moving)))
    assert all((page == first).all() for page in rest)
    assert len(encode_gif(moving)) < 3 * len(encode_gif(moving[:1]))


def test_a_small_target_keeps_its_color():
    frames = (
        np.random.default_rng(2)
        .normal([90, 120, 90], 12, (8, 64, 64, 3))
        .clip(0, 255)
        .astype(np.uint8)
    )
    frames[:, 20:24, 30:34] = target = (220, 40, 160)
    for page in pages(encode_gif(frames)):
        assert np.abs(np.array(page.getpixel((32, 22))) - target).max() < 12
