"""The columns are those of the specification, with their types, names and shapes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.features import (
    CAMERA_KEY,
    ENVIRONMENT_STATE,
    EPISODES,
    FEATURES,
    FRAMES,
    IMAGE_PREFIX,
    frame_features,
)
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.dataset.columns import Features, arrow_schema, info_features
from dynahoi_lerobot.dataset.episode_table import row_schema
from dynahoi_lerobot.dataset.language import LANGUAGE
from dynahoi_lerobot.dataset.paths import CODEBASE_VERSION, DATA_PATH, ROBOT_TYPE, TASKS_PATH, VIDEO_PATH
from dynahoi_lerobot.dataset.quality_control import EXECUTED
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset

LIMITS = ("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb")
LARGEST = 1e6
"""Of a limit: files per folder, or MiB."""
KNOWN = {"features", "total_episodes", "total_frames", "total_tasks", "splits"}
"""Entries of ``info.json`` that are compared with the tables here and in `counts`."""
TASKS_SCHEMA = pa.schema([("task_index", pa.int64()), ("task", pa.string())])


@CHECKS.register("schema")
class Schema(Check):
    """Compares ``info.json`` and the parquet files with the specification."""

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield constants and columns that differ."""
        yield from self._constants(dataset)
        yield from self._features(dataset)
        for paths, schema in (
            (dataset.data_files(), arrow_schema(dataset.features)),
            (dataset.row_files(), row_schema(dataset.features)),
            ([dataset.root / TASKS_PATH], TASKS_SCHEMA),
        ):
            for path in paths:
                yield from (f"{path.relative_to(dataset.root)} {problem}" for problem in _columns(path, schema))

    def _constants(self, dataset: CheckedDataset) -> Iterator[str]:
        constants = {
            "codebase_version": CODEBASE_VERSION,
            "fps": CONTROL_HZ,
            "robot_type": ROBOT_TYPE,
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if dataset.has_video else None,
        }
        for key, wanted in constants.items():
            if (found := dataset.info.get(key)) != wanted:
                yield f"info.json says {key} is {found!r}; it is {wanted!r}"
        for key in LIMITS:
            if not isinstance(found := dataset.info.get(key), int | float) or not 0 < found < LARGEST:
                yield f"info.json says {key} is {found!r}; it is a positive number"
        if unknown := sorted(dataset.info.keys() - constants.keys() - KNOWN - set(LIMITS)):
            yield f"info.json has the unknown entries {', '.join(unknown)}"

    def _views(self, dataset: CheckedDataset) -> list[str]:
        """The views that the recipe asks for; those that are stored where the recipe is not known."""
        stored = [key.removeprefix(IMAGE_PREFIX) for key in dataset.pictures if key != CAMERA_KEY]
        return dataset.manifest.provenance.get("recipe", {}).get("views", stored)

    def _features(self, dataset: CheckedDataset) -> Iterator[str]:
        camera = dataset.features.get(CAMERA_KEY)
        size = 0 if camera is None else camera["shape"][0]
        encoding = Encoding(codec="h264" if dataset.has_video else "images")
        contact_sensors = CAPTURES[dataset.rows[0]["capture"]].uses_contact_sensors
        on_policy = dataset.recipe.on_policy if dataset.recipe else EXECUTED in dataset.features
        provenance, stored = dataset.manifest.provenance, dataset.features
        features = frame_features(
            size,
            self._views(dataset),
            contact_sensors=contact_sensors,
            on_policy=on_policy,
            environment_state=provenance.get("recipe", {}).get("environment_state", ENVIRONMENT_STATE in stored),
            privileged=provenance.get("privileged_columns", _place(stored)) == FRAMES,
        )
        subtasks = provenance.get("subtasks", LANGUAGE in stored)
        wanted = info_features(features, encoding, subtasks=subtasks)
        for key in sorted(wanted.keys() | dataset.features.keys()):
            found = {name: value for name, value in dataset.features.get(key, {}).items() if name != "info"}
            if found != {name: value for name, value in wanted.get(key, {}).items() if name != "info"}:
                yield f"feature {key} is {found or 'missing'}; the specification has {wanted.get(key, 'no such one')}"


def _place(features: Features) -> str:
    return FRAMES if FEATURES["target_pose"].key in features else EPISODES


def _columns(path: Path, schema: pa.Schema) -> Iterator[str]:
    """Yield columns that a table lacks, has too many, or in other types or another order."""
    found = pq.read_schema(path)
    if missing := sorted(set(schema.names) - set(found.names)):
        yield f"lacks the columns {', '.join(missing)}"
    if unknown := sorted(set(found.names) - set(schema.names)):
        yield f"has the unknown columns {', '.join(unknown)}"
    if missing or unknown:
        return
    for field in schema:
        if found.field(field.name).type != field.type:
            yield f"holds {field.name} as {found.field(field.name).type}; it is {field.type}"
    if found.names != schema.names:
        yield "has its columns in another order"
