"""The interface of a metric: a pure function of an Episode, with its unit, direction, bounds and
condition.
"""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.registry import Registry, known
from dynahoi_lerobot.metrics.columns import COLUMNS, COMMANDS

Direction = Literal["higher", "lower"]
Aggregation = Literal["rate", "mean"]
Compute = Callable[[Episode], "float | bool | None"]


@dataclass(frozen=True)
class Metric:
    """One number per episode.

    Attributes:
        name: the name in every table, the paper's where it has one.
        compute: the function of one episode; its docstring gives the formula and the source.
        unit: any text that tables print, such as ``m/s``; of these, ``fraction`` is for shares and
            rates in [0, 1], which tables print in per cent, ``u`` is the paper's 0.1 m, and
            ``score`` is a number without a unit.
        direction: which way is better.
        aggregation: ``rate`` of values 0 or 1, with Wilson's interval; or ``mean`` of real values,
            with a bootstrap interval.
        bounds: least and greatest possible value, in ``unit``.
        condition: which episodes count, in words; empty when all do. The value of the others is
            None.
    """

    name: str
    compute: Compute
    unit: str
    direction: Direction
    aggregation: Aggregation
    bounds: tuple[float, float]
    condition: str = ""

    def __call__(self, episode: Episode) -> float | None:
        """Return the episode's value in ``unit``, or None where the condition does not hold.

        Raises:
            ValueError: for a value that ``admits`` refuses, which no reader of results would take.
        """
        value = self.compute(episode)
        if value is None:
            return None
        if not self.admits(float(value)):
            allowed = "0 or 1" if self.aggregation == "rate" else f"within {self.bounds}"
            raise ValueError(
                f"metric {self.name} of seed {episode.meta.seed} is {float(value)}, and its "
                f"decorator says {allowed}; correct the bounds or the formula, or return None for "
                "episodes to which it does not apply"
            )
        return float(value)

    def admits(self, value: float) -> bool:
        """Tell whether a value is finite and within the bounds, and of a rate 0 or 1."""
        low, high = self.bounds
        possible = low <= value <= high and math.isfinite(value)
        return possible and (self.aggregation == "mean" or value in (0.0, 1.0))

    @property
    def doc(self) -> str:
        """The definition: formula, unit and source."""
        return inspect.cleandoc(self.compute.__doc__ or "")

    @property
    def summary(self) -> str:
        """The first paragraph of the definition, in one line."""
        return " ".join(self.doc.partition("\n\n")[0].split())


METRICS: Registry[Metric] = Registry("metric", Metric)


def metric(
    name: str,
    *,
    unit: str,
    direction: Direction,
    aggregation: Aggregation,
    bounds: tuple[float, float] | None = None,
    condition: str = "",
) -> Callable[[Compute], Metric]:
    """Return a decorator that turns a function of an episode into the registered metric ``name``.

    Args:
        name, unit, direction, aggregation, condition: as ``Metric`` has them.
        bounds: least and greatest possible value, in ``unit``; by default 0 and 1 of a rate or a
            ``fraction``, and any finite value otherwise.

    Raises:
        ValueError: for another direction or aggregation, or the name of a column of results.
    """
    reserved = (*COLUMNS, COMMANDS)
    if name in reserved:
        raise ValueError(
            f"a metric cannot be named {name!r}, as a column of results or of a comparison is; "
            f"these names are reserved: {', '.join(reserved)}"
        )
    known("direction", direction, dict.fromkeys(get_args(Direction)))
    known("aggregation", aggregation, dict.fromkeys(get_args(Aggregation)))
    if bounds is None:
        is_share = aggregation == "rate" or unit == "fraction"
        bounds = (0.0, 1.0) if is_share else (-math.inf, math.inf)

    def decorate(compute: Compute) -> Metric:
        return METRICS.register(name)(
            Metric(name, compute, unit, direction, aggregation, bounds, condition)
        )

    return decorate


def measure(episode: Episode) -> dict[str, float | None]:
    """Return every registered metric of one episode by name; None where a metric's condition does
    not hold.
    """
    return {name: evaluate(episode) for name, evaluate in METRICS.items()}
