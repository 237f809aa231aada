"""Drawings of the concept pages: one episode of the expert and of pursuit, with what the metrics read off it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.foundation.conventions import CONTROL_DT, GRASP_FRACTION, LOCALIZATION_RADIUS_M, UNIT_M
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

KIND, NUMBER = "horizontal_circle", 4
"""An episode that the expert catches and that pursuit does not."""
SHOWN_AFTER_CATCH = 12
"""Frames that are drawn after the expert's catch."""
COLORS = {"expert": "#2f6db3", "pursuit": "#c46a2f"}
Episodes = dict[str, Episode]


def draw_concepts(folder: Path) -> None:
    """Draw every figure of the concept pages."""
    episodes = played()
    for name, draw in FIGURES.items():
        path = folder / "concepts" / f"{name}.svg"
        path.parent.mkdir(parents=True, exist_ok=True)
        _save(path, draw, episodes)


def played() -> Episodes:
    """Return the same episode of the expert and of pursuit."""
    recipe = Recipe(split="test", motions=(KIND,), control_class="standard")
    specs = sample_specs(recipe, [NUMBER])
    names = {"expert": "intercept", "pursuit": "pursuit"}
    return {label: next(evaluate(make_batch(recipe, 1), EXPERTS[name](), specs)) for label, name in names.items()}


def _save(path: Path, draw: Callable[[Axes, Episodes], None], episodes: Episodes) -> None:
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"svg.hashsalt": path.stem, "font.size": 9}):
        figure = Figure(figsize=(6.4, 2.8), layout="constrained")
        axes = figure.subplots()
        draw(axes, episodes)
        axes.spines[["top", "right"]].set_visible(False)
        figure.legend(frameon=False, loc="outside upper center", ncols=4)
        figure.savefig(path, metadata={"Date": None})


def _episode(axes: Axes, episodes: Episodes) -> None:
    """Distance over time, with the phases."""
    _distances(axes, episodes)
    start = _start_s(episodes["expert"])
    axes.axvspan(0, start, color="0.9")
    axes.text(start / 2, axes.get_ylim()[1], "observation window", ha="center", va="top")
    axes.text(start + 0.05, axes.get_ylim()[1], "control phase", va="top")


def _distance(axes: Axes, episodes: Episodes) -> None:
    """Distance over time, with E_loc and T."""
    _distances(axes, episodes)
    expert, pursuit = episodes.values()
    nearest = pursuit.control.start + int(pursuit.palm_distance[pursuit.control].argmin())
    place = (nearest * CONTROL_DT, pursuit.palm_distance[nearest] / UNIT_M)
    axes.plot(*place, "o", color=COLORS["pursuit"])
    axes.annotate(
        "$E_{loc}$ of pursuit", place, xytext=(4, 44), textcoords="offset points", arrowprops={"arrowstyle": "-"}
    )
    ends = _start_s(expert), (expert.first_localized or 0) * CONTROL_DT
    axes.annotate("", (ends[1], -0.25), (ends[0], -0.25), arrowprops={"arrowstyle": "<->", "color": COLORS["expert"]})
    axes.text(np.mean(ends), -0.3, "$t^* - t_c$ of the expert", ha="center", va="top")
    axes.set_ylim(bottom=-0.8)


def _joints(axes: Axes, episodes: Episodes) -> None:
    """Share of the reference rotation over time, and the threshold."""
    episode, end = episodes["expert"], _end(episodes)
    turned = episode.reference_joints != episode.open_joints
    wanted = (episode.reference_joints - episode.open_joints)[turned]
    share = (episode.joints[:end] - episode.open_joints)[:, turned] / wanted  # (T, J)
    lines = axes.plot(np.arange(len(share)) * CONTROL_DT, share, color=COLORS["expert"], alpha=0.4)
    lines[0].set_label("joints of the expert")
    axes.axhline(GRASP_FRACTION, color="0.3", linestyle="--", label=f"{GRASP_FRACTION} of the reference grasp")
    axes.axvline((episode.first_localized or 0) * CONTROL_DT, color="green", label="localised")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("share of the rotation")


def _path(axes: Axes, episodes: Episodes) -> None:
    """The palm's paths from above, step by step, and the straight ways."""
    for label, episode in episodes.items():
        path = episode.palm_pos_h[episode.meta.window_frames : (episode.first_localized or _end(episodes)) + 1]
        axes.plot(path[:, 1], path[:, 0], ".-", color=COLORS[label], label=f"steps of {label}")
        axes.plot(path[[0, -1], 1], path[[0, -1], 0], ":", color=COLORS[label], label=f"straight way of {label}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("across [m]")
    axes.set_ylabel("ahead [m]")


def _distances(axes: Axes, episodes: Episodes) -> None:
    for label, episode in episodes.items():
        distance = episode.palm_distance[: _end(episodes)] / UNIT_M
        axes.plot(np.arange(len(distance)) * CONTROL_DT, distance, color=COLORS[label], label=label)
    axes.axhline(LOCALIZATION_RADIUS_M / UNIT_M, color="0.3", linestyle="--", label="threshold 0.3 u")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("palm to target [u]")


def _start_s(episode: Episode) -> float:
    return episode.meta.window_frames * CONTROL_DT


def _end(episodes: Episodes) -> int:
    return (episodes["expert"].first_localized or 0) + SHOWN_AFTER_CATCH


FIGURES: dict[str, Callable[[Axes, Episodes], None]] = {
    "episode": _episode,
    "distance": _distance,
    "joints": _joints,
    "path": _path,
}
"""What draws each figure."""
