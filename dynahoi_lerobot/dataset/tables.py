"""Parquet files that roll over at a size limit, and LeRobot's task table."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.dataset.paths import FileLimits

MIB = 1 << 20


class RollingParquet:
    """Writes tables one row group each and starts a new file before one would exceed the limit."""

    def __init__(self, root: Path, template: str, schema: pa.Schema, limits: FileLimits) -> None:
        """Write files named by ``template`` below ``root``."""
        self._root, self._template, self._schema, self._limits = root, template, schema, limits
        self._sink: pa.NativeFile | None = None
        self._writer: pq.ParquetWriter | None = None
        self._number = -1

    def upcoming(self, table: pa.Table) -> tuple[int, int]:
        """Make room for ``table``; return the (chunk, file) index it will go to."""
        limit = self._limits.data_mb * MIB
        if self._sink is None or self._sink.tell() + table.nbytes >= limit:
            self._open_next()
        return self._limits.place(self._number)

    def write(self, table: pa.Table) -> tuple[int, int]:
        """Append ``table`` as one row group; return the (chunk, file) index it went to."""
        place = self.upcoming(table)
        self.append(table)
        return place

    def append(self, table: pa.Table) -> None:
        """Append ``table`` to the file that ``upcoming`` chose."""
        if self._writer is None:
            raise RuntimeError("no file is open; call upcoming first")
        self._writer.write_table(table)

    def close(self) -> None:
        """Finish the current file."""
        if self._writer is not None and self._sink is not None:
            self._writer.close()
            self._sink.close()
        self._writer = self._sink = None

    def _open_next(self) -> None:
        self.close()
        self._number += 1
        path = self._limits.path(self._root, self._template, self._number)
        self._sink = pa.OSFile(str(path), "wb")
        self._writer = pq.ParquetWriter(self._sink, self._schema, compression="snappy", use_dictionary=True)


def write_tasks(tasks: list[str], path: Path) -> None:
    """Write LeRobot's task table: pandas must find the texts as the index named ``task``."""
    text = {
        "name": "task",
        "field_name": "task",
        "pandas_type": "unicode",
        "numpy_type": "object",
        "metadata": None,
    }
    number = {
        "name": "task_index",
        "field_name": "task_index",
        "pandas_type": "int64",
        "numpy_type": "int64",
        "metadata": None,
    }
    note = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [number, text],
        "pandas_version": "2.3.3",
    }
    schema = pa.schema([("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": json.dumps(note)})
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table([list(range(len(tasks))), tasks], schema=schema), path, compression="snappy")


def read_tasks(path: Path) -> list[str]:
    """Return the task texts in the order of their indices."""
    rows = pq.read_table(path).sort_by("task_index")
    return rows["task"].to_pylist()
