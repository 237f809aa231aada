"""The benchmark's dataset on the Hub: its episodes as tables, and the leaderboards.

``python -m dynahoi_lerobot.hub.benchmark_repo DIR`` writes the folder, and ``dynahoi push DIR USER/dynahoi-benchmark``
uploads it with a card that names that repository.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.arguments import path
from dynahoi_lerobot.foundation.output import check_output
from dynahoi_lerobot.hub.leaderboards import CARD_REPO, EVAL_FILE, SPLITS, eval_yaml
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import split_seeds

CARD = """---
pretty_name: DynaHOI {version}
license: apache-2.0
task_categories: [robotics]
tags: [robotics, benchmark, dynahoi, lerobot, mujoco]
configs:
- config_name: default
  data_files:
{files}
---

# DynaHOI {version}: catching moving objects

A five-fingered hand watches a moving object, predicts where to meet it and catches it. One row is one episode of the
benchmark: its seed, motion, object, instruction and length. The seed is all that is needed to play it:

```
pip install '.[lerobot]' ./envs/lerobot_env_dynahoi   # in a checkout of dynahoi-lerobot
dynahoi evaluate --policy USER/POLICY --split test --out results
dynahoi push results USER/POLICY --leaderboard {repo}
```

A result is ranked if all episodes of a split were played. `dynahoi certify` computes it again from the log of its
commands. `eval.yaml` lists the leaderboards: split, capture rule, control class and metric.
"""


def write(folder: Path, count: int | None = None) -> None:
    """Write card, leaderboards and a table of each ranked split, of its first ``count`` episodes if that is given."""
    (folder / "data").mkdir(parents=True, exist_ok=True)
    for split in SPLITS:
        specs = sample_specs(Recipe(split=split), split_seeds(split)[:count], threads=0)
        pq.write_table(pa.Table.from_pylist(rows(specs)), folder / _file(split))
    files = "\n".join(f"  - split: {split}\n    path: {_file(split)}" for split in SPLITS)
    (folder / "README.md").write_text(CARD.format(version=BENCHMARK.version, files=files, repo=CARD_REPO))
    (folder / EVAL_FILE).write_text(eval_yaml())


def rows(specs: Sequence[EpisodeSpec]) -> list[dict[str, Any]]:
    """Return a row an episode."""
    return [
        {
            "seed": spec.seed,
            "motion": spec.motion.name,
            "category": spec.motion.category,
            "object": spec.target.name,
            "task": spec.task,
            "window_frames": spec.window_frames,
            "length_frames": spec.length_frames,
            "intercept_frame": spec.intercept_frame,
            "benchmark": BENCHMARK.version,
        }
        for spec in specs
    ]


def _file(split: str) -> str:
    return f"data/{split}.parquet"


def main() -> None:
    """Write the folder that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=path)
    folder = parser.parse_args().folder
    check_output(folder)
    write(folder)


if __name__ == "__main__":
    main()
