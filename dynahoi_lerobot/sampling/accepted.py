"""Where the draws of the benchmark's episodes succeeded, so that nothing has to be rejected again.

`accepted.npz` holds an entry of `ENTRY` for every seed of the splits of fixed size, as
`benchmarks/pin.py` found it by drawing. An entry only saves time: an episode that begins from it
is the one that a search finds, and if what follows from an entry is not what it says, the episode
is searched.
"""

import functools
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.sampling.benchmark import BENCHMARK, BENCHMARK_ID
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.timing import Timing

ENTRIES = Path(__file__).with_name("accepted.npz")
"""One array of `ENTRY` by stream, in the order of the seeds, and ``benchmark``, whose episodes they
are."""
ENTRY = np.dtype(
    [
        ("generator", "<u8", 2),  # low and high half of the state before the motion was drawn
        ("buffered", "<u4"),  # half of a drawn number that the generator still holds ...
        ("has_buffered", "u1"),  # ... if this is 1
        ("home", "u1"),  # index of the one chosen among the homes tried
        ("length_frames", "<u2"),
        ("window_frames", "u1"),
        ("approach_frames", "u1"),
        ("travel_m", "<f8"),
        ("checksum", "<u4"),
    ]
)
DECIMALS = 6
"""To which checksums round [m, kg], as another processor may round otherwise."""
HALF_STATE = 2**64


def entries_of(recipe: Recipe) -> Mapping[int, np.void]:
    """Return the entry of each seed of a recipe; none if its episodes are not the benchmark's own.

    They are where motions, objects, protocol, hand and the frames after the intercept are those of
    the split, without a salt. Nothing else has a part in what is rejected.
    """
    usual = Recipe(split=recipe.split)
    if recipe.salt or _decisive(recipe) != _decisive(usual):
        return {}
    stream = recipe.split_definition.stream
    return dict(enumerate(_shipped().get(stream, ())))


def _decisive(recipe: Recipe) -> tuple[Any, ...]:
    rules = recipe.rules
    return (
        recipe.motion_names,
        recipe.object_names,
        rules.protocol,
        rules.hand_name,
        rules.capture_rule.hold_frames,
    )


@functools.cache
def _shipped() -> dict[str, np.ndarray]:
    """Return the entries by stream; none if they are those of another benchmark, or not there."""
    if not ENTRIES.exists():
        return {}
    with np.load(ENTRIES) as stored:
        if str(stored["benchmark"]) != BENCHMARK_ID:
            return {}
        return {name: stored[name] for name in BENCHMARK.streams if name in stored}


def begin_at(entry: np.void, rng: np.random.Generator) -> Timing:
    """Put the generator of an episode's seed where the draws that ``entry`` holds began; return the
    timing drawn before.
    """
    state: dict[str, Any] = dict(rng.bit_generator.state)  # with the increment of the seed
    low, high = (int(half) for half in entry["generator"])
    state["state"]["state"] = low + HALF_STATE * high
    state["has_uint32"], state["uinteger"] = int(entry["has_buffered"]), int(entry["buffered"])
    rng.bit_generator.state = state
    return Timing(
        length_frames=int(entry["length_frames"]),
        window_frames=int(entry["window_frames"]),
        approach_frames=int(entry["approach_frames"]),
        travel_m=float(entry["travel_m"]),
    )


def entry_of(state: Mapping[str, Any], timing: Timing, home: int, checksum: int) -> np.void:
    """Return the `ENTRY` of an episode.

    Args:
        state: of its generator before the accepted motion was drawn.
        timing: drawn before.
        home: index of the chosen one among `homes.tried_homes`.
        checksum: of `checksum_of`.
    """
    high, low = divmod(state["state"]["state"], HALF_STATE)
    values = (
        (low, high),
        state["uinteger"],
        state["has_uint32"],
        home,
        timing.length_frames,
        timing.window_frames,
        timing.approach_frames,
        timing.travel_m,
        checksum,
    )
    return np.array([values], ENTRY)[0]


def checksum_of(paths_w: Sequence[np.ndarray], home_pos_w: np.ndarray, target: TargetObject) -> int:
    """Return a checksum of what an entry leads to: (F, 3) paths of the episode and of its twins and
    (3,) home [m], world, and the object's mass and size.
    """
    size = [target.mass_kg, target.grasp_radius_m, target.rest_height_m]
    drawn = np.concatenate([*(path_w.ravel() for path_w in paths_w), home_pos_w, size])
    return zlib.crc32((np.round(drawn, DECIMALS) + 0.0).astype("<f8").tobytes())
