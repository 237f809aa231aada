"""The manifest's plan is one that gives these episodes: seeds, their order, yields, encoding, file limits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.features import CAMERA_KEY
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.sampling.splits import MAX_DRAWS, REDRAW_STRIDE
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset

PLAN = {
    "recipe": dict, "episodes": int, "seed": int, "encoding": dict, "limits": dict, "shard_episodes": int,
    "code": str, "runtime": str, "privileged_columns": str, "subtasks": bool,
}  # fmt: skip
"""What ``generate`` writes into the manifest. A copy of some episodes has ``kept`` as well."""
LIMITS = {"chunks_size": "chunk_files", "data_files_size_in_mb": "data_mb", "video_files_size_in_mb": "video_mb"}
"""Keys of ``info.json`` by the plan's limits."""


@CHECKS.register("provenance")
class Provenance(Check):
    """Compares the manifest's plan with the tables; a dataset that no plan made has seeds only."""

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield what the plan does not give."""
        rows, manifest = dataset.rows, dataset.manifest
        if len(manifest.seeds) != len(rows):
            yield f"the manifest lists {len(manifest.seeds)} seeds for {len(rows)} episodes"
        for number, (row, seed) in enumerate(zip(rows, manifest.seeds, strict=False)):
            if row["seed"] != seed:
                yield f"episode {number} has seed {row['seed']}; the manifest says {seed}"
        if (found := ", ".join(sorted({row["benchmark"] for row in rows}))) != manifest.benchmark:
            yield f"the episodes are of benchmark {found!r}; the manifest says {manifest.benchmark!r}"
        plan = {key: value for key, value in manifest.provenance.items() if key != "kept"}
        if not plan:
            return
        if problem := _malformed(plan):
            yield problem
            return
        if dataset.recipe is None:
            yield f"the manifest's recipe cannot be read: {plan['recipe']}"
        kept = manifest.provenance.get("kept", list(range(plan["episodes"])))
        yield from _seeds([row["seed"] for row in rows], plan, kept)
        yield from _yields(manifest.yields, rows)
        yield from _storage(dataset, plan)


def _malformed(plan: dict[str, Any]) -> str | None:
    if plan.keys() != PLAN.keys():
        return f"the manifest's plan lacks or adds {', '.join(sorted(plan.keys() ^ PLAN.keys()))}"
    wrong = [key for key, kind in PLAN.items() if type(plan[key]) is not kind]
    if wrong:
        return f"the manifest's plan has {wrong[0]} {plan[wrong[0]]!r}"
    if plan["episodes"] < 1 or plan["shard_episodes"] < 1:
        return f"the manifest's plan has {plan['episodes']} episodes in shards of {plan['shard_episodes']}"
    return None


def _seeds(seeds: list[int], plan: dict[str, Any], kept: list[int]) -> Iterator[str]:
    """Yield seeds that no slot of the plan draws, and seeds out of the order in which shards are filled."""
    first, shard = plan["seed"], plan["shard_episodes"]
    slots = [seed % REDRAW_STRIDE - first for seed in seeds]
    for number, (seed, slot) in enumerate(zip(seeds, slots, strict=True)):
        if not (0 <= slot < plan["episodes"] and 0 <= seed < MAX_DRAWS * REDRAW_STRIDE):
            yield f"episode {number} has seed {seed}; the plan draws {plan['episodes']} seeds from {first} on"
            return
    if len(set(slots)) != len(slots) or len(slots) != len(kept):
        yield f"{len(set(slots))} of the plan's {plan['episodes']} seeds are there; it keeps {len(kept)}"
    # a shard plays its first draws in order, then the redraws of those that failed
    order = [(slot // shard, seed // REDRAW_STRIDE, slot) for seed, slot in zip(seeds, slots, strict=True)]
    if order != sorted(order):
        number = next(n for n in range(1, len(order)) if order[n] < order[n - 1])
        yield f"episode {number} has seed {seeds[number]} after seed {seeds[number - 1]}; the plan has another order"


def _yields(yields: dict[str, int], rows: list[EpisodeRow]) -> Iterator[str]:
    if not yields:
        return  # as in a copy
    counted, seeds = Counter(yields), [row["seed"] for row in rows]
    if counted["kept"] != len(seeds) or counted["tried"] != counted["kept"] + counted["missed"] + counted["rejected"]:
        yield f"the manifest's yields {yields} do not give {len(seeds)} episodes"
    elif counted["tried"] != (drawn := sum(1 + seed // REDRAW_STRIDE for seed in seeds)):
        yield f"the manifest says {counted['tried']} seeds were tried; the episodes' seeds say {drawn}"
    if counted["failed"] != (failed := sum(not row["success"] for row in rows)):
        yield f"the manifest says {counted['failed']} episodes failed; the episode table has {failed}"


def _storage(dataset: CheckedDataset, plan: dict[str, Any]) -> Iterator[str]:
    """Yield where camera, encoding and file limits are not those of ``info.json``."""
    size, camera = plan["recipe"].get("image_size"), dataset.features.get(CAMERA_KEY)
    if size != (camera["shape"][0] if camera else 0):
        yield f"the manifest says image_size {size}; info.json has {', '.join(dataset.pictures) or 'no view'}"
    for key, name in LIMITS.items():
        if "kept" not in dataset.manifest.provenance and plan["limits"].get(name) != dataset.info.get(key):
            yield f"info.json says {key} {dataset.info.get(key)}; the manifest says {plan['limits'].get(name)}"
    try:
        encoding = Encoding(**plan["encoding"])
    except (TypeError, ValueError) as error:
        yield f"the manifest's encoding cannot be read: {error}"
        return
    if asdict(encoding) != plan["encoding"]:
        yield f"the manifest's encoding is {plan['encoding']}"
    yield from _encoding(dataset.features, encoding)


def _encoding(features: Features, encoding: Encoding) -> Iterator[str]:
    codec = encoding.make_codec()
    for key, feature in features.items():
        if feature["dtype"] not in ("image", "video"):
            continue
        wanted = codec.info(feature["shape"][0], CONTROL_HZ) if codec.is_video else None
        if (feature["dtype"] == "video") != codec.is_video or feature.get("info") != wanted:
            yield f"feature {key} is stored as {feature.get('info', 'images')}; the manifest's encoding gives {wanted}"
