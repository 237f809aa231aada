"""What each metric says of privileged baselines on the same few episodes."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.metrics import METRICS, Metric, measure
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

BASELINES = {
    "expert": "intercept",
    "constant velocity": "constant_velocity",
    "pursuit": "pursuit",
    "never moves": "hold",
}
"""Name of the baseline, by what the plots call it; the same ones in every plot, from best to worst."""
COLOR, MEAN_COLOR = "#7aa6d6", "#c44e52"
Values = dict[str, list[float]]


def draw_metrics(folder: Path) -> None:
    """Draw a plot for every metric: its value in one episode of each kind of motion."""
    recipe = Recipe(split="test", control_class="standard")
    specs = sample_specs(recipe, range(len(recipe.motion_names)))
    played = {
        label: [measure(episode) for episode in evaluate(make_batch(recipe, len(specs)), EXPERTS[name](), specs)]
        for label, name in BASELINES.items()
    }
    for name, metric in METRICS.items():
        values = {label: [value for row in rows if (value := row[name]) is not None] for label, rows in played.items()}
        _save(folder / "metrics" / f"{name}.svg", metric, values)


def _save(path: Path, metric: Metric, values: Values) -> None:
    """Write one plot."""
    from matplotlib.figure import Figure

    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": metric.name, "font.size": 9}):
        figure = Figure(figsize=(6, 0.5 * len(values) + 0.8), layout="constrained")
        axes = figure.subplots()
        for row, numbers in enumerate(values.values()):
            _draw_row(axes, -row, numbers)
        axes.set_yticks([-row for row in range(len(values))], [f"{label} ({len(n)})" for label, n in values.items()])
        axes.set_xlabel(f"{metric.name} [{metric.unit}], {metric.direction} is better")
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(path, metadata={"Date": None})


def _draw_row(axes: matplotlib.axes.Axes, height: int, numbers: list[float]) -> None:
    """Draw one dot an episode, those of equal value above each other, and a line at their mean."""
    if not numbers:
        axes.text(0.5, height, "no episode counts", ha="center", va="center", transform=axes.get_yaxis_transform())
        return
    places, counts = np.unique(np.round(numbers, 2), return_counts=True)
    axes.scatter(places, np.full(len(places), height), s=14 * counts, color=COLOR, alpha=0.7)
    axes.plot([np.mean(numbers)] * 2, [height - 0.35, height + 0.35], color=MEAN_COLOR)
