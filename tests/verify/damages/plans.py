"""A manifest whose plan would not have given these episodes."""

from __future__ import annotations

from tests.verify.forgery import MANIFEST, Table, entry, plan

PLANS: Table = {
    "fewer episodes planned": (plan(episodes=5), "default", "the plan draws 5 seeds"),
    "no camera planned": (
        entry(MANIFEST, lambda m: m["provenance"]["recipe"].update(image_size=0)), "default", "says image_size 0"
    ),
    "another rate factor": (
        entry(MANIFEST, lambda m: m["provenance"]["encoding"].update(crf=1)), "default", "the manifest's encoding gives"
    ),
    "other shards": (plan(shard_episodes=0), "default", "in shards of 0"),
    "other file limits": (
        entry(MANIFEST, lambda m: m["provenance"]["limits"].update(data_mb=1)), "default", "the manifest says 1"
    ),
    "an unknown recipe": (plan(recipe={"split": "moon"}), "default", "recipe cannot be read"),
    "half a plan": (entry(MANIFEST, lambda m: m["provenance"].pop("code")), "default", "lacks or adds code"),
    "no plan at all": (entry(MANIFEST, lambda m: m.update(provenance={})), "replay", "names no recipe"),
    "another benchmark": (
        entry(MANIFEST, lambda m: m.update(benchmark="v0")), "default", "the manifest says 'v0'"
    ),
    "other yields": (entry(MANIFEST, lambda m: m["yields"].update(tried=99)), "default", "yields"),
}  # fmt: skip
