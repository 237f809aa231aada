"""``README.md`` of a dataset: LeRobot's template, filled. The same dataset gives the same bytes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template, Undefined

from dynahoi_lerobot.core.conventions import CONTROL_HZ, HAND_DOF
from dynahoi_lerobot.dataset.card.figures import histogram_svg
from dynahoi_lerobot.dataset.card.tables import counts, episode_table, frame_table
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.paths import CARD_PATH, CODEBASE_VERSION, HISTOGRAMS_PATH, MANIFEST_PATH, PICTURE_PATH
from dynahoi_lerobot.dataset.store import Store

LICENSE = "apache-2.0"
HOMEPAGE = "the Python package `dynahoi_lerobot`"
PAPER = (
    "[DynaHOI: Benchmarking Hand-Object Interaction for Dynamic Target](https://github.com/HuBocheng/DynaHOI) "
    "(Hu, Zhao, Zhou, Wang, Wang; 2026)"
)
CITATION = """@misc{hu2026dynahoi,
  title  = {{DynaHOI}: Benchmarking Hand-Object Interaction for Dynamic Target},
  author = {Hu and Zhao and Zhou and Wang and Wang},
  year   = {2026}
}"""
METADATA = {
    "license": LICENSE,
    "task_categories": ["robotics"],
    "tags": ["LeRobot", "dynahoi", "robotics", "dexterous-manipulation", "simulation", "mujoco"],
    "configs": [{"config_name": "default", "data_files": "data/*/*.parquet"}],
}
"""Metadata for the Hub's search and viewer."""


def finish_with_card(root: Path, manifest: Manifest) -> Manifest:
    """Write the card, its images and then the manifest, which lists them.

    Args:
        root: a dataset that lacks only these files.
        manifest: names every other file.

    Returns:
        The manifest that was written.
    """
    _write_card(root, manifest)
    complete = replace(manifest, files=hash_files(root, manifest.files))
    complete.write(root)
    return complete


def _write_card(root: Path, manifest: Manifest) -> None:
    histograms = json.loads((root / HISTOGRAMS_PATH).read_text())
    pictures = {PICTURE_PATH.format(key=key): key for key in histograms}
    for name, key in pictures.items():
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text(histogram_svg(histograms[key]), encoding="utf-8")
    (root / CARD_PATH).write_text(_card(Store(root), manifest, pictures), encoding="utf-8")


def _card(store: Store, manifest: Manifest, pictures: dict[str, str]) -> str:
    metadata = METADATA | {"size_categories": [_size_category(manifest.frames)]}
    return _template("lerobot.md").render(
        card_data=yaml.safe_dump(metadata, sort_keys=False).rstrip(),
        dataset_description=_description(store, manifest, pictures),
        dataset_structure=_template("structure.md").render(
            version=CODEBASE_VERSION,
            frame_table=frame_table(store.features),
            episode_table=episode_table(store.features),
        ),
        url=HOMEPAGE,
        paper=PAPER,
        license=LICENSE,
        citation_bibtex=CITATION,
    )


def _description(store: Store, manifest: Manifest, pictures: dict[str, str]) -> str:
    kinds, successes = counts(store.row_files(), "motion")
    objects, _ = counts(store.row_files(), "object")
    facts: dict[str, Any] = {name: getattr(manifest, name) for name in ("episodes", "frames", "benchmark", "digest")}
    return _template("description.md").render(
        facts,
        fps=CONTROL_HZ,
        hand_dof=HAND_DOF,
        manifest_path=MANIFEST_PATH,
        successes=successes,
        kinds=kinds,
        objects=objects,
        pictures=pictures,
        provenance=manifest.provenance,
        yields=manifest.yields,
        recipe=yaml.safe_dump(manifest.provenance, sort_keys=False),
    )


def _template(name: str) -> Template:
    """Return a template of this package; LeRobot's may leave variables undefined."""
    undefined = Undefined if name == "lerobot.md" else StrictUndefined
    folder = Path(__file__).with_name("templates")
    return Environment(loader=FileSystemLoader(folder), undefined=undefined, autoescape=False).get_template(name)


def _size_category(rows: int) -> str:
    """Return the Hub's name for this number of rows, such as ``10K<n<100K``."""
    bounds = [(10**3, "1K"), (10**4, "10K"), (10**5, "100K"), (10**6, "1M"), (10**7, "10M"), (10**8, "100M")]
    below = "n"
    for bound, name in bounds:
        if rows < bound:
            return f"{below}<{name}" if below == "n" else f"{below}<n<{name}"
        below = name
    return f"n>{below}"
