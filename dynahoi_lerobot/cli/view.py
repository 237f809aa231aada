"""``dynahoi view``: one episode, newly played, from a dataset or from results, as GIF, MP4 or a web
page.

With ``--sample`` a page of several episodes of a dataset.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.cli.sample_page import (
    SHEET_COLUMNS,
    column,
    filled,
    read_episode,
    sheet,
    write_sample,
)
from dynahoi_lerobot.cli.thoughts import drawn
from dynahoi_lerobot.core.arguments import given_of, option, refuse_given, refuse_others, whole
from dynahoi_lerobot.core.conventions import (
    CONTROL_HZ,
    DETECTOR_IMAGE_SIZE_PX,
    EGO_VIEW,
    SEED_LIMIT,
)
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.core.features import EYE, IMAGE_PREFIX
from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.protocols import is_acting
from dynahoi_lerobot.core.reading import reading
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.evaluate.actors import (
    AS_TRAINED,
    EXPERT_ALIAS,
    TRUST,
    make_actor,
    playing_rules,
)
from dynahoi_lerobot.evaluate.gif import BORDERS, encode_gif, frame_phases, phases_of
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.replay_results import open_recipe
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.renderers.views import VIEWS
from dynahoi_lerobot.rollout.loop import evaluate, replay
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.fingerprint import recipe_code
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import kind_seeds
from dynahoi_lerobot.world.batch import WorldBatch

HEEDED = {
    "dataset": ("dataset", "episode", "sample", "view", "out"),
    "results": ("results", "seed", "view", "out", "image_size", "salt"),
}
"""Options that have an effect on episodes that were played before, by their source."""
SHOWN_PX = 384
"""Least width of a clip, in which episodes are rendered, unless a policy sees smaller images."""


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames of one episode.

    Attributes:
        frames: (T, H, W, 3) uint8 RGB.
        caption: one line of text.
        phases: ``observing``, ``acting`` or ``localized`` for each frame; None if they are not
            known.
        fps: frames per second.
    """

    frames: np.ndarray
    caption: str
    phases: list[str] | None
    fps: float = CONTROL_HZ


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi view``."""

    motion: str | None = option(None, "render a new episode of this motion")
    dataset: Path | None = option(None, "render an episode of this dataset")
    results: Path | None = option(None, "replay and render an episode of this result folder")
    episode: int = option(0, "with --dataset: episode index")
    sample: int | None = option(
        None,
        "with --dataset: a page with N episodes of each motion, to inspect frames, actions and "
        "target",
        whole(1, 100),
        metavar="N",
    )
    seed: int = option(
        0,
        "with --motion: episode number within split and motion; with --results: episode seed",
        whole(0, SEED_LIMIT - 1),
    )
    split: str = option("test", "with --motion: train, val, test, twins or one of the ood_ splits")
    policy: str = option("expert", "with --motion: a checkpoint or a baseline")
    thoughts: bool = option(
        False,
        "with --motion and a checkpoint of ObAct as --policy: draw what it sees, expects and "
        "attends to",
    )
    trust: bool = option(False, TRUST)
    given: dict[str, Any] = given_of(Recipe, AS_TRAINED)
    view: str = option(EGO_VIEW, "camera, optionally its depth or segmentation", choices=VIEWS)
    out: Path = option(Path("episode.gif"), "output file: .gif, .mp4 or .html")


def run(options: Options) -> int:
    """Write the clip; return the exit code."""
    suffix = options.out.suffix
    if suffix not in WRITERS:
        raise ValueError(
            f"cannot write {suffix or 'a file without suffix'!r}; use {', '.join(WRITERS)}"
        )
    if options.sample is not None:
        return _sample(options.sample, options)
    sources = {"motion": _played, "dataset": _from_dataset, "results": _replayed}
    chosen = [name for name in sources if getattr(options, name) is not None]
    if options.thoughts and (
        options.motion is None or options.policy in (EXPERT_ALIAS, *EXPERTS.names())
    ):
        raise ValueError(
            "--thoughts draws what a policy thinks while it plays: give --motion MOTION --policy "
            "CHECKPOINT"
        )
    if len(chosen) != 1:
        raise ValueError(
            "choose one of --motion MOTION, --dataset DIR --episode I, --results DIR --seed S"
        )
    (name,) = chosen
    _refuse_ignored(options, name)
    clip = sources[name](getattr(options, name), options)
    write_clip(options.out, clip)
    print(printable(f"{options.out}: {clip.caption}"))
    return 0


def _refuse_ignored(options: Options, source: str) -> None:
    """Refuse options that would have no effect on an episode of a ``source``."""
    without = f"has no effect with --{source}"
    if source in HEEDED:
        refuse_others(options, HEEDED[source], without)
    else:
        refuse_given(options, ["episode"], without)


def _sample(per_kind: int, options: Options) -> int:
    """Write the page of a sample; return the exit code."""
    if options.dataset is None or options.motion is not None or options.results is not None:
        raise ValueError("--sample takes its episodes from --dataset DIR")
    if options.out.suffix != ".html":
        raise ValueError(
            f"--sample writes a web page, so --out must end in .html, got {options.out}"
        )
    _refuse_ignored(options, "dataset")
    store = Store(options.dataset)
    store.check_files()
    if not all("motion" in row for row in store.rows):
        raise ValueError(
            f"{options.dataset} does not name the motions of its episodes, so there is nothing "
            f"to stratify by"
        )
    key = _camera_key(options, store)
    with reading(options.dataset):
        shown = write_sample(options.out, store, key, per_kind)
    print(
        f"{options.out}: {shown} episodes of {options.dataset}; mark some to see the command "
        f"that removes them"
    )
    return 0


def _played(motion: str, options: Options) -> Clip:
    """Play a new episode with the policy or expert."""
    given = dict(options.given)
    if options.thoughts:
        actor = PolicyAgent(options.policy, trust=options.trust)
        actor.thoughts = []
    else:
        actor = make_actor(options.policy, given.get("capture", Rules.capture), trust=options.trust)
    if not actor.sees_images:
        seen_by_the_eye = actor.environment_state == EYE
        given.setdefault("image_size", DETECTOR_IMAGE_SIZE_PX if seen_by_the_eye else SHOWN_PX)
    if options.view != EGO_VIEW:
        given["views"] = (*given.get("views", ()), options.view)
    # what is not part of the benchmark is listed by no split
    if not BENCHMARK.splits_with("motion", motion):
        given["motions"] = (motion,)
    recipe = Recipe.of(split=options.split, **playing_rules(given, actor))
    known = kind_seeds(recipe, motion)
    if options.seed >= len(known):
        raise ValueError(
            f"split {options.split!r} has {len(known)} episodes of motion {motion!r}, so --seed "
            f"must be 0 to "
            f"{len(known) - 1}, got {options.seed}"
        )
    spec = sample_specs(recipe, [known[options.seed]])[0]
    batch = WorldBatch(recipe.rules, 1)
    episode = next(evaluate(batch, actor, [spec], images=True))
    clip = _clip(episode, options.view, episode.meta.agent)
    thoughts = actor.thoughts if isinstance(actor, PolicyAgent) else None
    if thoughts is None:
        return clip
    if any(thought is None for thought in thoughts):
        raise ValueError(
            f"--thoughts draws what ObAct records of its decisions; {actor.name} records nothing"
        )
    return replace(clip, frames=drawn(episode, thoughts, batch, options.view))


def _replayed(folder: Path, options: Options) -> Clip:
    """Replay an evaluated episode's actions, rendered at any image size."""
    results = read_results(folder)
    seeds = [row["seed"] for row in results.rows]
    if options.seed not in seeds:
        raise ValueError(
            f"{folder} has no episode with seed {options.seed}; it has {min(seeds)} to {max(seeds)}"
        )
    recipe = open_recipe(results, options.given.get("salt", ""))
    if recipe_code(recipe) != results.info.code:
        print("other code produced these results: the replay may differ from the evaluated episode")
    index = seeds.index(options.seed)
    size = options.given.get("image_size", SHOWN_PX)
    views = () if options.view == EGO_VIEW else (options.view,)
    # the commands are known, and nobody looks but the reader
    shown = changed(recipe, {"image_size": size, "views": views, "environment_state": ""})
    (episode,) = replay(shown, [results.log(index)], as_evaluated=True)  # a log may go on for days
    return _clip(episode, options.view, results.info.policy)


def _clip(episode: Episode, view: str, agent: str) -> Clip:
    if view not in episode.images:
        raise ValueError("a clip needs images, and --image-size is 0")
    return Clip(
        episode.images[view], f"{agent}: {episode.meta.task} {episode.stage}", phases_of(episode)
    )


def _from_dataset(root: Path, options: Options) -> Clip:
    """Read an episode of a dataset."""
    store = Store(root)
    store.check_files()
    if not 0 <= options.episode < store.episodes:
        raise ValueError(f"--episode must be 0 to {store.episodes - 1}, got {options.episode}")
    key = _camera_key(options, store)
    with reading(root):
        row, _, images = read_episode(store, options.episode, key)
        frames = slice(row["dataset_from_index"], row["dataset_to_index"])
        return Clip(images, str(row["tasks"][0]), _stored_phases(root, frames), store.fps)


def _camera_key(options: Options, store: Store) -> str:
    """Return the key of the chosen view's images."""
    key = IMAGE_PREFIX + options.view
    if key not in store.image_keys:
        cameras = ", ".join(store.image_keys) or "none at all"
        raise ValueError(f"{options.dataset} has no view {options.view!r}, only {cameras}")
    return key


def _stored_phases(root: Path, frames: slice) -> list[str] | None:
    """Return the phase of each frame, None if the dataset lacks it."""
    phase, localized = (column(root, name) for name in ("observation.phase", "localized"))
    if phase is None or localized is None:
        return None
    return frame_phases(is_acting(phase[frames]), localized[frames, 0].astype(bool))


# -- files -----------------------------------------------------------------------------------------


CLIP_PAGE = Path(__file__).with_name("clip_page.html")


def write_clip(path: Path, clip: Clip) -> None:
    """Write ``clip`` atomically, in the format of the suffix of ``path``, one of ``WRITERS``;
    create folders.
    """
    write_atomically({path: lambda draft: WRITERS[path.suffix](draft, clip)})


def _write_gif(path: Path, clip: Clip) -> None:
    shown = {"fps": clip.fps, "caption": clip.caption, "phases": clip.phases}
    path.write_bytes(encode_gif(clip.frames, **shown, min_width=SHOWN_PX))


def _write_html(path: Path, clip: Clip) -> None:
    """Write a page that plays at full speed or slower, and can be stopped."""
    count, *sides = clip.frames.shape[:3]
    scale = max(1, round(SHOWN_PX / sides[1]))
    height, width = (scale * side for side in sides)
    data = {"sheet": sheet(clip.frames), "columns": SHEET_COLUMNS, "count": count, "fps": clip.fps}
    borders = {phase: f"rgb{color}" for phase, color in BORDERS.items()}
    data |= {"width": width, "height": height, "phases": clip.phases, "borders": borders}
    words = {"caption": clip.caption, "count": count, "width": width, "height": height}
    path.write_text(filled(CLIP_PAGE, data, **words), encoding="utf-8")


def _write_mp4(path: Path, clip: Clip) -> None:
    """Write the frames without caption and phases."""
    import av

    odd = [(0, side % 2) for side in clip.frames.shape[1:3]]  # yuv420p halves both sides
    frames = np.pad(clip.frames, [(0, 0), *odd, (0, 0)], mode="edge")
    with av.open(str(path), "w", format="mp4") as video:
        stream = video.add_stream("h264", rate=Fraction(clip.fps).limit_denominator(1001))
        stream.width = frames.shape[2]
        stream.height = frames.shape[1]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            video.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        video.mux(stream.encode())


WRITERS = {
    ".gif": _write_gif,
    ".mp4": _write_mp4,
    ".html": _write_html,
}
"""Function that writes a clip to a path, by the suffix of the file."""
