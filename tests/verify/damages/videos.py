"""Videos encoded again from other pictures."""

from __future__ import annotations

from pathlib import Path

from tests.verify.forgery import Table, pictures


def shuffled(root: Path) -> None:
    """All pictures of the first video in reverse."""
    pictures(lambda frames: frames[::-1])(root)


VIDEOS: Table = {
    "pictures in reverse": (shuffled, "replay", "another picture of ego"),
    "black pictures": (pictures(lambda x: [f * 0 for f in x]), "decode", "does not show what its statistics"),
    "mirrored pictures": (pictures(lambda x: [f[:, ::-1] for f in x]), "replay", "another picture of ego"),
    "a missing frame in a video": (pictures(lambda x: x[:-1]), "default", "frames; its episodes have"),
    "a video at another rate": (pictures(list, fps=25), "default", "has (height"),
    "no key frame at a start": (pictures(list, cut=False), "default", "has no key frame at frame"),
    "a video of another size": (pictures(lambda x: [f[::2, ::2] for f in x]), "default", "has (height"),
}  # fmt: skip
