"""``dynahoi encode``: copy a dataset, replacing its images by what an image sensor sees in them.

A frozen encoder gives the same output for an image every time. So a policy with such an encoder can
learn from columns ``observation.sightings.<view>`` of a few numbers per frame. LeRobot loads whole
windows of these in the time that it needs to decode a few images.
"""

import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr
from copy import deepcopy
from dataclasses import dataclass, replace
from io import StringIO
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from dynahoi_lerobot.core.arguments import argument, option
from dynahoi_lerobot.core.conventions import EGO_VIEW, PALM_DOF
from dynahoi_lerobot.core.features import (
    ENVIRONMENT_STATE,
    EYE,
    IMAGE_PREFIX,
    OBSERVATION_PREFIX,
    SIGHTING_NAMES,
)
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.core.image_sensor import ImageSensor, image_sensor
from dynahoi_lerobot.core.machine import cores
from dynahoi_lerobot.core.reading import reading
from dynahoi_lerobot.dataset import paths
from dynahoi_lerobot.dataset.card import write_card
from dynahoi_lerobot.dataset.manifest import ENCODED, Manifest, file_problems, hash_files
from dynahoi_lerobot.dataset.statistics import column_stats
from dynahoi_lerobot.dataset.store import (
    Store,
    StoredEpisode,
    episode_column,
    frame_column,
    open_dataset,
)
from dynahoi_lerobot.world.detector import eye_state

EPISODES_AT_ONCE = 64  # whose tables are in memory
SIGHTINGS_PREFIX = OBSERVATION_PREFIX + "sightings."
"""Prefix of the key of a column with the sightings in a view."""
UNREAD = ("observation.touch", "next.reward", "next.done")
"""Columns that no policy with such an encoder reads. LeRobot formats all columns for all frames of
every window, so each one slows its loader down."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi encode``."""

    root: Path = argument("dataset folder; it is not changed")
    out: Path = argument("folder of the new dataset, which must not exist")
    sensor: str = option(EYE, "image sensor that an installed package brings")
    environment_state: bool = option(
        False,
        "also add observation.environment_state, for policies without history: where the eye sees "
        "the target from the hand's camera, now and 2, 4 and 8 frames ago",
    )


def run(options: Options) -> int:
    """Encode the dataset, print a summary, and return the exit code."""
    manifest = encode(
        options.root, options.out, options.sensor, environment_state=options.environment_state
    )
    told = {"root": str(options.out), "episodes": manifest.episodes, "frames": manifest.frames}
    print(json.dumps(told | {"sha256": manifest.digest}, indent=2))
    return 0


def encode(
    root: Path, output: Path, sensor: str = EYE, *, environment_state: bool = False
) -> Manifest:
    """Write a copy of a dataset with sightings instead of images; ``output`` appears when it is
    complete.

    Everything else is kept, also what policies must not see, except for the columns `UNREAD`.

    Args:
        root: the dataset.
        output: folder of the copy.
        sensor: name of an image sensor.
        environment_state: also add what environments show under ``environment_state=eye``.

    Raises:
        FileExistsError: if ``output`` exists.
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if there is no such sensor, or no view of the dataset that it knows, or the
            dataset has no manifest, or other files than that lists.
    """
    from lerobot.datasets.dataset_tools import modify_features

    if output.exists():
        raise FileExistsError(f"{output} exists; choose a new folder")
    store = Store(root)
    manifest = Manifest.read(root)
    names = [key.removeprefix(IMAGE_PREFIX) for key in store.image_keys]
    views = {view: image_sensor(sensor)(view) for view in names}
    if not views:
        raise ValueError(f"{root} has no images to encode")
    if environment_state and (sensor != EYE or EGO_VIEW not in views):
        raise ValueError(
            f"{root} has no images of the hand's camera for the eye to see: the views are "
            f"{', '.join(views)} and the sensor is {sensor!r}"
        )
    if environment_state and ENVIRONMENT_STATE in store.features:
        raise ValueError(f"{root} already has {ENVIRONMENT_STATE}; leave --environment-state out")
    problem = next(file_problems(root, manifest), None)
    if problem:
        raise ValueError(f"{root} is not what it was when its manifest was written: {problem}")
    dataset = open_dataset(root)
    columns = _sightings(store, views)
    added: dict[str, Any] = {
        SIGHTINGS_PREFIX + view: (values, _vector(values, views[view].names))
        for view, values in columns.items()
    }
    left_out = [*store.image_keys, *(key for key in UNREAD if key in dataset.features)]
    provenance = deepcopy(manifest.provenance)
    provenance[ENCODED] = {"sensor": sensor, "from": manifest.digest}
    if environment_state:
        values = _eye_states(store, type(views[EGO_VIEW]), columns[EGO_VIEW])
        added[ENVIRONMENT_STATE] = (values, _vector(values, SIGHTING_NAMES))
        if provenance.get("recording"):
            provenance["recording"]["recipe"]["rules"]["environment_state"] = EYE
    with new_folder(output) as folder:
        with redirect_stderr(StringIO()):  # two bars of progress for seconds
            modify_features(dataset, added, left_out, folder, dataset.repo_id)
        _copy_unknown(root / "meta", folder / "meta")
        _forget(folder, left_out)
        stats = json.loads((folder / paths.STATS_PATH).read_text())
        for key, (values, _) in added.items():
            found = column_stats(values)
            stats[key] = {name: value.tolist() for name, value in found.items()}
        paths.write_json(stats, folder / paths.STATS_PATH)
        described = replace(manifest, provenance=provenance, files={})
        write_card(Store(folder), described)
        signed = replace(described, files=hash_files(folder))
        signed.write(folder)
    return signed


def _sightings(store: Store, views: dict[str, ImageSensor]) -> dict[str, np.ndarray]:
    """Return the sightings of all frames by view, (N, D) float32."""

    def see(stored: StoredEpisode) -> dict[str, np.ndarray]:
        sightings = {}
        for view, sensor in views.items():
            images = store.images(stored.row, stored.frames, IMAGE_PREFIX + view)
            before = np.concatenate([images[:1], images[:-1]])
            sightings[view] = sensor.see(images, before)
        return sightings

    found: list[dict[str, np.ndarray]] = []
    # decoders and networks release Python's lock
    with reading(store.root), ThreadPoolExecutor(cores()) as pool:
        for episodes in batched(store.stored_episodes(), EPISODES_AT_ONCE):
            found += pool.map(see, episodes)
    return {view: np.concatenate([sightings[view] for sightings in found]) for view in views}


def _vector(values: np.ndarray, names: Sequence[str]) -> dict[str, Any]:
    """Return LeRobot's description of a column (N, D)."""
    return {"dtype": "float32", "shape": [values.shape[1]], "names": [*names]}


def _eye_states(store: Store, sensor: type[ImageSensor], sightings: np.ndarray) -> np.ndarray:
    """Return the ``environment_state`` (N, 14) that follows from sightings (N, 5) of all frames."""
    palms = frame_column(store.root, "observation.state")[:, :PALM_DOF]
    ends = np.cumsum(store.lengths)[:-1]
    episodes = zip(
        np.split(sightings, ends),
        np.split(palms, ends),
        episode_column(store.root, "ego_camera"),
        episode_column(store.root, "ego_intrinsics"),
        strict=True,
    )
    return np.concatenate([eye_state(sensor, *episode) for episode in episodes])


def _forget(root: Path, keys: Sequence[str]) -> None:
    """Remove from the episode table the statistics and places in videos of columns that are gone:
    LeRobot's tools fail to edit a dataset that still has them.
    """
    prefixes = tuple(f"{kind}/{key}/" for kind in ("stats", "videos") for key in keys)
    for path in sorted((root / "meta" / "episodes").rglob("*.parquet")):
        table = pq.read_table(path)
        gone = [name for name in table.column_names if name.startswith(prefixes)]
        pq.write_table(table.drop_columns(gone), path)


def _copy_unknown(source: Path, target: Path) -> None:
    """Copy the files that LeRobot does not know; its tools leave them out."""
    for path in sorted(source.rglob("*")):
        copy = target / path.relative_to(source)
        if path.is_file() and not copy.exists() and path.name != Path(paths.MANIFEST_PATH).name:
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
