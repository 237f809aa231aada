"""Every episode is one that the manifest's recipe makes: names, instruction, seed's motion, fingerprint."""

from __future__ import annotations

from collections.abc import Iterator

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.rules import protocol_of
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.teacher_labels import Lead
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import NEUTRAL, REVEALING
from dynahoi_lerobot.sampling.timing import window_frames
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns
from dynahoi_lerobot.verify.stored_motion import stored_motion

STYLES = {"reveal": (REVEALING,), "neutral": (NEUTRAL,), "mixed": (REVEALING, NEUTRAL)}


@CHECKS.register("recipe")
class RecipeCheck(Check):
    """Compares the episode table's names with what the recipe draws from; without a recipe only the task's text."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield values that the recipe does not give."""
        where = f"episode {row['episode_index']}"
        if not row["task"].isprintable() or not row["task"].strip():
            yield f"{where}: task {row['task']!r} is no line of printable text"
        CAPTURES[row["capture"]]
        if (recipe := dataset.recipe) is None:
            return
        for name, allowed in _allowed(recipe, row, dataset.manifest.provenance.get("code")).items():
            if row[name] not in allowed:
                wanted = ", ".join(map(repr, allowed))
                yield f"{where}: {name} is {row[name]!r}; seed and recipe allow {wanted}"
        yield from (f"{where}: {problem}" for problem in _lengths(recipe, row))


def _allowed(recipe: Recipe, row: EpisodeRow, code: str | None) -> dict[str, list[object]]:
    """Return by column the values that the recipe gives an episode of this seed, motion and object."""
    expert, names = EXPERTS[recipe.expert], recipe.motion_names
    first = 1 if row["success"] else 1 + expert.retries
    phrase = stored_motion(row["motion"], row["parameters"]).phrase
    return {
        "motion": [names[row["seed"] % len(names)]],
        "object": list(recipe.object_names),
        "task": [text.format(object=row["object"], phrase=phrase) for text in STYLES[recipe.instructions]],
        "agent": [expert.name if _expert_leads(recipe, row["seed"]) else recipe.actor],
        "actor": [recipe.actor],
        "attempts": [1] if recipe.on_policy else list(range(first, 2 + expert.retries)),
        "capture": [recipe.capture],
        "protocol": [recipe.protocol],
        "split": [recipe.split_label],
        "fingerprint": [recipe.fingerprint(code)],
        "benchmark": [BENCHMARK.version],
    }


def _expert_leads(recipe: Recipe, seed: int) -> bool:
    return not recipe.on_policy or Lead.drawn(seed, recipe.teacher_share).led


def _lengths(recipe: Recipe, row: EpisodeRow) -> Iterator[str]:
    """Yield lengths that the recipe does not give: window, and frames after the intercept."""
    length, window, intercept = row["length_frames"], row["window_frames"], row["intercept_frame"]
    has_window = protocol_of(recipe.protocol).has_window
    if window and not has_window:
        yield f"window_frames is {window}; protocol {recipe.protocol!r} has no window"
    drawn = length - CAPTURES[recipe.capture].hold_frames  # at least so many frames were drawn before the rule's own
    if has_window and window < (least := window_frames(max(drawn, 0))):
        yield f"window_frames is {window}; of {length} frames at least {least} observe"
    if not window < intercept < length:
        yield f"intercept_frame is {intercept}; it lies between the window's {window} and the length's {length} frames"
    if recipe.hold_frames is not None and length > intercept + 1 + recipe.hold_frames:
        yield f"length_frames is {length}; the recipe holds {recipe.hold_frames} frames after frame {intercept}"
