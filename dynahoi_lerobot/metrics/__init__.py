"""Metrics: pure functions of an episode, with formula, unit, direction and source."""

from dynahoi_lerobot.metrics import (  # noqa: F401 - they register the metrics
    grasp,
    localization,
    trajectory,
)
from dynahoi_lerobot.metrics.base import METRICS, Metric, measure, metric

__all__ = ["METRICS", "Metric", "measure", "metric"]
