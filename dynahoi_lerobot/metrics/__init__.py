"""Metrics: pure functions of an Episode, one file each, with formula, unit, direction and source."""

from dynahoi_lerobot.metrics.base import METRICS, Metric, measure, metric

__all__ = ["METRICS", "Metric", "measure", "metric"]
