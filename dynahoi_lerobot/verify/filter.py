"""``dynahoi filter``: copy a dataset without the episodes that are named, or that the paper's
outlier rule rejects.

Appendix "Post-processing": an episode is an outlier if it leaves the robust range of a column of
the whole dataset.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.arguments import argument, option, refuse_given
from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.core.reading import reading
from dynahoi_lerobot.dataset.columns import BOOKKEEPING, numeric_keys
from dynahoi_lerobot.dataset.merge import copy_subset
from dynahoi_lerobot.dataset.store import Store, frame_column

MARGIN = 1.0
"""Default margin on either side, in widths of the robust range."""
ROUNDING = 1e-6
"""Excursions up to this [unit of the column] are rounding of float32."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi filter``."""

    root: Path = argument("dataset folder; it is not changed")
    out: Path | None = option(None, "folder of the new dataset, which must not exist")
    margin: float = option(
        MARGIN, "tolerance on either side of [q01, q99], in widths of that range"
    )
    column: str = option("action", "column to check")
    drop: tuple[str, ...] = option((), "comma-separated episodes to drop instead of the outliers")
    dry_run: bool = option(False, "only print what would be dropped")


def run(options: Options) -> int:
    """Print the outliers and copy all other episodes; return the exit code."""
    output = None if options.dry_run else options.out
    if output is None and not options.dry_run:
        raise ValueError(
            "give --out DIR for the new dataset, or --dry-run to see which episodes it would "
            "leave out"
        )
    if options.drop:
        refuse_given(options, ("margin", "column"), "finds outliers, and has no effect with --drop")
    episodes = Store(options.root).episodes
    outliers = {} if options.drop else find_outliers(options.root, options.margin, options.column)
    unknown = sorted(set(options.drop) - set(map(str, range(episodes))))
    if unknown:
        raise ValueError(
            f"--drop names episode {unknown[0][:40]!r}; {options.root} has 0 to {episodes - 1}"
        )
    left_out = sorted({int(word) for word in options.drop} if options.drop else outliers)
    if output is not None:
        copy_subset(
            options.root, output, [index for index in range(episodes) if index not in left_out]
        )
    for sentence in outliers.values():
        print(printable(sentence))
    where = (
        "dry run, nothing was written" if options.dry_run else f"the others are in {options.out}"
    )
    print(f"{options.root}: {len(left_out)} of {episodes} episodes left out; {where}")
    return 0


def find_outliers(root: Path, margin: float = MARGIN, column: str = "action") -> dict[int, str]:
    """Find episodes that leave ``[q01 - margin * width, q99 + margin * width]``, width being ``q99
    - q01``.

    Args:
        root: the dataset's folder.
        margin: widths of the robust range that are allowed beyond it.
        column: key of the (T, D) column of the frame table to look at.

    Returns:
        A sentence about the greatest excursion of each such episode, by its index. NaN and infinity
        are excursions.

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if the margin is negative or not finite, there is no such column, or one in a
            hundred of its values is not finite.
    """
    if not 0 <= margin < np.inf:
        raise ValueError(f"the margin is {margin}; it must be a finite number, 0 or more")
    store = Store(root)
    known = [key for key in numeric_keys(store.features) if key not in BOOKKEEPING]
    if column not in known:
        raise ValueError(f"there is no column {column!r}; known: {', '.join(known)}")
    with reading(root):
        values = frame_column(root, column).astype(float)
    q01, q99 = np.quantile(
        np.where(np.isfinite(values), values, np.inf), [0.01, 0.99], axis=0, method="inverted_cdf"
    )
    if not np.isfinite([q01, q99]).all():
        raise ValueError(
            f"{column} is often not finite, so it has no robust range; see "
            f"`dynahoi verify {shlex.quote(str(root))}`"
        )
    low = q01 - margin * (q99 - q01)
    high = q99 + margin * (q99 - q01)
    names = store.features[column].get("names")
    if not isinstance(names, list) or len(names) != len(low):
        names = range(len(low))
    outliers: dict[int, str] = {}
    for row in store.rows:
        part = values[row["dataset_from_index"] : row["dataset_to_index"]]
        beyond = np.maximum(low - part, part - high)  # (T, D), positive outside
        beyond = np.nan_to_num(beyond, nan=np.inf)
        frame, axis = np.unravel_index(int(beyond.argmax()), beyond.shape)
        if beyond[frame, axis] > ROUNDING:
            count = int((beyond[:, axis] > ROUNDING).sum())
            frames = f"{count} frame" + "s" * (count != 1)
            reach = f"{column}.{names[axis]} reaches {part[frame, axis]:.3f}"
            sentence = f"{reach}, outside {low[axis]:.3f} to {high[axis]:.3f} in {frames}"
            outliers[row["episode_index"]] = f"episode {row['episode_index']}: {sentence}"
    return outliers
