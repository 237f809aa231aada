"""Episodes, frames and tasks are as many as every table says."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow.parquet as pq

from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset


@CHECKS.register("counts")
class Counts(Check):
    """Compares ``info.json``, the episode table, the frame table, the task table and the manifest."""

    of_the_format = True

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield totals that differ."""
        info, rows = dataset.info, dataset.rows
        frames = sum(pq.read_metadata(path).num_rows for path in dataset.data_files())
        lengths = sum(row["length"] for row in rows)
        totals = (
            ("info.json says {} episodes, the episode table has {}", info["total_episodes"], len(rows)),
            ("info.json says {} frames, the data files have {}", info["total_frames"], frames),
            ("the episode table says {} frames, the data files have {}", lengths, frames),
            ("info.json says {} tasks, the task table has {}", info["total_tasks"], len(dataset.tasks)),
            ("info.json says the split {}, it should be {}", info["splits"], {"train": f"0:{len(rows)}"}),
        )
        if dataset.has_manifest:
            manifest = dataset.manifest
            totals += (
                ("the manifest says {} episodes, the episode table has {}", manifest.episodes, len(rows)),
                ("the manifest says {} frames, the data files have {}", manifest.frames, frames),
            )
        yield from (sentence.format(said, found) for sentence, said, found in totals if said != found)
