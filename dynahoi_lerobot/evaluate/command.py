"""``dynahoi evaluate``: run a policy or an expert on a split and write the result folder."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import batched
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.agent import Actor, Agent
from dynahoi_lerobot.core.arguments import (
    given_of,
    number,
    option,
    refuse_given,
    refuse_others,
    whole,
)
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE, EYE, TRUTH
from dynahoi_lerobot.core.progress import progress_bar
from dynahoi_lerobot.core.protocols import PROTOCOLS
from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.evaluate import replay_results
from dynahoi_lerobot.evaluate.actors import (
    AS_TRAINED,
    EXPERT_ALIAS,
    TRUST,
    VLM,
    make_actor,
    playing_rules,
)
from dynahoi_lerobot.evaluate.results import (
    Results,
    RunInfo,
    finished,
    kept_results,
    read_results,
    saved_extra,
)
from dynahoi_lerobot.evaluate.table import kind_table, results_table
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.inference import (
    INFERENCE_MODES,
    MAX_LATENCY_MS,
    SYNC,
    Inference,
    RealTimeAgent,
)
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import SMALL_TEST, split_seeds
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, PROMPTS
from dynahoi_lerobot.world.batch import WorldBatch

FOR_VLM = ("model", "prompt", "base_url", "request_timeout")
"""Options of vision-language models."""
FOR_REPLAY = ("replay", "replay_seed", "episodes", "salt")
"""Options of a replay, which else follows the result folder."""


def _latency(text: str) -> float | None:
    """Parse ``--inference-ms``; None is ``measured``."""
    return None if text == "measured" else number(0.0, MAX_LATENCY_MS)(text)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi evaluate``."""

    replay: Path | None = option(
        None,
        "re-execute the commands of a result folder and compare all numbers",
        metavar="RESULTS",
    )
    policy: str = option(
        "",
        f"checkpoint folder, Hub repository, vlm, or a privileged baseline: expert, "
        f"{', '.join(EXPERTS.names())}",
    )
    split: str = option(SMALL_TEST, "test, test_small, val, twins or one of the ood_ splits")
    out: Path | None = option(None, "result folder; an incomplete one is resumed")
    episodes: int | None = option(
        None,
        "number of episodes: the first of the split, or random ones with --replay; all by default",
    )
    replay_seed: int | None = option(
        None,
        "with --replay: seed of the draw, as printed by an earlier replay",
        whole(0, 2**32 - 1),
    )
    given: dict[str, Any] = given_of(Recipe, AS_TRAINED)
    batch_size: int = option(
        32,
        "worlds simulated in parallel, without effect on the results of baselines and ObAct; 1 "
        "for policies with "
        "--inference-ms measured",
        whole(1, 4096),
    )
    gifs: int = option(
        0, "number of episodes to record as GIFs in --out: the first of the split", whole(0, 10**6)
    )
    per_kind: bool = option(False, "also print a row for each kind of motion")
    device: str | None = option(None, "torch device of the policy")
    trust: bool = option(False, TRUST)
    set: list[str] = option(
        list,
        "override a field of the policy's config, such as n_action_steps=2 or "
        "embodiment.delay_frames=3; dictionaries as JSON; may be repeated",
        metavar="KEY=VALUE",
    )
    inference: str = option(
        SYNC,
        "; ".join(f"{mode}: {meaning}" for mode, meaning in INFERENCE_MODES.items()),
        choices=INFERENCE_MODES,
    )
    inference_ms: float | None = option(
        0.0,
        "with --inference async or rtc: inference time [ms], or measured for the time on this "
        "machine",
        _latency,
        metavar="MS",
    )
    model: str | None = option(None, "with --policy vlm: model name at the endpoint")
    prompt: str = option(DEFAULT_PROMPT, f"with --policy vlm: prompt, {' or '.join(PROMPTS)}")
    base_url: str | None = option(
        None,
        "with --policy vlm: URL of an OpenAI-compatible endpoint; its key is read from "
        "OPENAI_API_KEY",
    )
    request_timeout: float = option(
        60.0,
        "with --policy vlm: time limit of a decision with all its requests [s]",
        number(0.001, 86_400.0),
    )


def run(options: Options) -> int:
    """Evaluate, write the results and print them; return the exit code."""
    if bool(options.replay) == bool(options.policy):
        raise ValueError("give --policy NAME or --replay RESULTS, and not both")
    if options.replay_seed is not None and not options.replay:
        raise ValueError(f"--replay-seed {options.replay_seed} is for --replay RESULTS")
    if options.replay:
        refuse_others(options, FOR_REPLAY, "has no effect with --replay")
        if options.episodes is not None and options.episodes < 1:
            raise ValueError(f"--episodes must be 1 or more, got {options.episodes}")
        return replay_results.run(
            options.replay, options.given.get("salt", ""), options.episodes, options.replay_seed
        )
    if options.gifs and not options.out:
        raise ValueError(f"--gifs {options.gifs} needs --out, the folder to write them to")
    _refuse_ignored(options)
    inference = Inference(options.inference, options.inference_ms)
    actor = _real_time(_actor(options), inference)
    recipe = Recipe.of(split=options.split, **playing_rules(options.given, actor))
    if inference.mode != SYNC and recipe.rules.control_mode != JOINTS:
        raise ValueError(
            f"--inference {inference.mode} needs control_mode {JOINTS!r}, got "
            f"{recipe.rules.control_mode!r}"
        )
    wanted = _seeds(options)
    info = RunInfo.begun(
        actor.name if options.policy == VLM else options.policy,
        recipe,
        actor.weights,
        inference=inference.label,
        settings=options.set,
        privileged=actor.privileged,
        episodes_asked=len(wanted),
    )
    with kept_results(options.out, info) as earlier:
        _refuse_missing_clips(options, earlier)
        seeds = [seed for seed in wanted if seed not in earlier.seeds]
        asked = saved_extra(options.out).get(VLM, {}) if options.policy == VLM else {}
        info.extra.update({VLM: asked} if asked else {})
        results = earlier if seeds else _finished(earlier)
        for episodes in _played(options, recipe, actor, seeds, _batch_size(options, inference)):
            results = results.plus(episodes)
            report = actor.report()
            if VLM in report:
                report[VLM] = _added(asked, report[VLM])
            info.extra.update(report)
            if options.out:
                results.write()
    print(results_table([results]))
    if options.policy == VLM:
        account = results.info.extra.get(VLM, {})
        print("\n" + ", ".join(f"{name} {value}" for name, value in account.items()))
    if options.per_kind:
        print("\n" + kind_table(results).as_text())
    return 0


def _refuse_ignored(options: Options) -> None:
    """Refuse options that would have no effect on who plays."""
    name = options.policy
    if name != VLM:
        refuse_given(options, FOR_VLM, f"is for --policy {VLM}, not {name}")
    if name in (EXPERT_ALIAS, VLM, *EXPERTS.names()):
        refuse_given(options, ["device", "trust"], f"is for a LeRobot policy, not {name}")


def _added(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """Return two accounts of one run as one: counts and seconds add up."""
    whole = {**before, **now}
    for name in before.keys() & now.keys():
        if isinstance(now[name], dict):
            whole[name] = _added(before[name], now[name])
        elif type(now[name]) in (int, float):
            whole[name] = before[name] + now[name]
    return whole


def _finished(results: Results) -> Results:
    """Return results of which nothing was left to play, as they are if they are whole."""
    with suppress(ReadError):
        return finished(read_results(results.folder))
    results.write()  # the earlier run ended between the renaming of two files, or was to be longer
    return results


def _real_time(actor: Actor, inference: Inference) -> Actor:
    """Give the actor an inference that takes time."""
    if inference.mode == SYNC:
        return actor
    if not (isinstance(actor, Agent) and actor.plans):
        raise ValueError(
            f"--inference {inference.mode} needs a policy that plans chunks; {actor.name!r} is "
            f"an expert"
        )
    return RealTimeAgent(actor, inference)


def _batch_size(options: Options, inference: Inference) -> int:
    """Return how many worlds are played together: one where the time of a LeRobot policy's
    inference is measured.

    Such a policy infers for all worlds at once, which takes longer than for one robot. VLMs are
    asked world by world.
    """
    measured = inference.mode != SYNC and inference.latency_ms is None
    return 1 if measured and options.policy != VLM else options.batch_size


def _actor(options: Options) -> Actor:
    capture = options.given.get("capture", Rules.capture)
    actor = (
        _vlm(options)
        if options.policy == VLM and not options.set
        else make_actor(options.policy, capture, options.device, options.set, trust=options.trust)
    )
    shown = options.given.get("environment_state")
    if actor.environment_state is None:
        if not shown:
            raise ValueError(
                f"{options.policy} reads {ENVIRONMENT_STATE}, and its checkpoint does not say "
                f"which; add --environment-state {TRUTH} or {EYE}"
            )
        actor.environment_state = shown
        actor.privileged = shown == TRUTH
    if actor.environment_state == TRUTH and shown is None:
        raise ValueError(
            f"{options.policy} reads {ENVIRONMENT_STATE}, the simulator's truth; add "
            f"--environment-state {TRUTH} to "
            "let it: its results are then marked as privileged"
        )
    if shown is not None and shown != actor.environment_state:
        needed = (
            f"--environment-state {actor.environment_state}"
            if actor.environment_state
            else "none; leave it out"
        )
        raise ValueError(f"--environment-state is {shown!r}, but {options.policy} needs {needed}")
    return actor


def _vlm(options: Options) -> Agent:
    """Return the vision-language model that the arguments name."""
    from dynahoi_lerobot.vlm.agent import VlmAgent, VlmClient

    if not options.model:
        raise ValueError(
            "--policy vlm needs --model NAME, and --base-url URL unless the model is OpenAI's"
        )
    rules = Recipe.of(split=options.split, **options.given).rules
    if PROTOCOLS[rules.protocol].blind_control:
        raise ValueError(
            f"--policy vlm decides by what it sees while acting, which is nothing under "
            f"{rules.protocol}"
        )
    client = VlmClient(
        options.model,
        options.base_url,
        timeout_s=options.request_timeout,
        prompt=options.prompt,
        palm_speed_m_s=rules.capture_rule.palm_speed_m_s(rules.control),
        log=options.out / "vlm.jsonl" if options.out else None,
    )
    return VlmAgent(client, name=f"vlm:{options.model}:{options.prompt}")


def _clip_seeds(options: Options) -> set[int]:
    """Return the seeds whose episodes are drawn as GIFs: the first ones of the split."""
    return set(split_seeds(options.split)[: options.gifs])


def _clip_path(folder: Path, motion: str, seed: int) -> Path:
    return folder / f"{motion}_{seed}.gif"


def _refuse_missing_clips(options: Options, earlier: Results) -> None:
    """Raise a ValueError if an episode that was played without ``--gifs`` is now to be recorded:
    it is not played again.
    """
    shown = _clip_seeds(options)
    folder = earlier.folder
    for row in earlier.rows:
        seed = row["seed"]
        if seed in shown and not _clip_path(folder, row["kind"], seed).exists():
            raise ValueError(
                f"--gifs {options.gifs} comes too late: {folder} holds the episode of seed {seed} "
                f"without a clip; leave it out, and draw clips with `dynahoi view --results "
                f"{shlex.quote(str(folder))} --seed {seed} --out FILE.gif`"
            )


def _seeds(options: Options) -> Sequence[int]:
    """Return the seeds to play."""
    seeds = split_seeds(options.split)
    if options.episodes is not None:
        if not 1 <= options.episodes <= len(seeds):
            raise ValueError(
                f"--episodes must be 1 to {len(seeds)}, all of split {options.split}; got "
                f"{options.episodes}"
            )
        seeds = seeds[: options.episodes]
    return seeds


def _played(
    options: Options, recipe: Recipe, actor: Actor, seeds: list[int], size: int
) -> Iterator[list[Episode]]:
    """Play the episodes of ``seeds`` and yield them in batches of ``size``, without images; those
    of the first seeds of the split are written as GIFs.
    """
    if not seeds:
        return
    batch = WorldBatch(recipe.rules, min(size, len(seeds)))
    shown = _clip_seeds(options)
    with progress_bar(
        total=len(seeds), desc=f"{options.policy} on {options.split}", unit="episode"
    ) as progress:
        for group in batched(seeds, size):
            specs = sample_specs(recipe, group, threads=0)
            # a policy's noise depends on the number of worlds, also when it is resumed
            if len(group) < batch.size:
                batch = WorldBatch(recipe.rules, len(group))
            played = []
            images = not shown.isdisjoint(group)
            for episode in evaluate(batch, actor, specs, images=images):
                if options.out and episode.meta.seed in shown:
                    from dynahoi_lerobot.evaluate.gif import episode_gif  # which brings in OpenCV

                    clip = _clip_path(options.out, episode.meta.motion, episode.meta.seed)
                    episode_gif(clip, episode)
                played.append(replace(episode, images={}))
                progress.update()
            yield played
