"""The columns are those of the specification, with their types, names and shapes."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow.parquet as pq

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.dataset.codecs.base import Encoding
from dynahoi_lerobot.dataset.columns import arrow_schema, info_features
from dynahoi_lerobot.dataset.episode_table import OWN_COLUMNS
from dynahoi_lerobot.dataset.paths import CODEBASE_VERSION, ROBOT_TYPE
from dynahoi_lerobot.features import CAMERA_KEY, IMAGE_PREFIX, frame_features
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset


@CHECKS.register("schema")
class Schema(Check):
    """Compares ``info.json`` and the parquet files with the specification."""

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield constants and columns that differ."""
        constants = {"fps": CONTROL_HZ, "codebase_version": CODEBASE_VERSION, "robot_type": ROBOT_TYPE}
        for key, wanted in constants.items():
            if (found := dataset.info[key]) != wanted:
                yield f"info.json says {key} is {found!r}; it is {wanted!r}"
        yield from self._features(dataset)
        schema = arrow_schema(dataset.features)
        for path in dataset.data_files():
            if not pq.read_schema(path).equals(schema):
                yield f"{path.relative_to(dataset.root)} has columns or types that info.json does not describe"
        for path in dataset.row_files():
            if missing := sorted(set(OWN_COLUMNS) - set(pq.read_schema(path).names)):
                yield f"{path.relative_to(dataset.root)} lacks the columns {', '.join(missing)}"

    def _views(self, dataset: CheckedDataset) -> list[str]:
        """The views that the recipe asks for; those that are stored where the recipe is not known."""
        stored = [key.removeprefix(IMAGE_PREFIX) for key in dataset.pictures if key != CAMERA_KEY]
        return dataset.manifest.provenance.get("recipe", {}).get("views", stored)

    def _features(self, dataset: CheckedDataset) -> Iterator[str]:
        camera = dataset.features.get(CAMERA_KEY)
        size = None if camera is None else camera["shape"][0]
        encoding = Encoding(codec="h264" if dataset.has_video else "images")
        contact_sensors = CAPTURES[dataset.rows[0]["capture"]].uses_contact_sensors
        features = frame_features(size, self._views(dataset), contact_sensors=contact_sensors)
        wanted = info_features(features, encoding)
        for key in sorted(wanted.keys() | dataset.features.keys()):
            found = {name: value for name, value in dataset.features.get(key, {}).items() if name != "info"}
            if found != {name: value for name, value in wanted.get(key, {}).items() if name != "info"}:
                yield f"feature {key} is {found or 'missing'}; the specification has {wanted.get(key, 'no such one')}"
