"""``dynahoi evaluate``: run a policy or an expert on a split and write the result folder."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import replace
from itertools import batched
from pathlib import Path

from tqdm import tqdm

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.agent import Actor, Agent, ChunkAgent
from dynahoi_lerobot.core.arguments import add_field_arguments, given_fields, number, path, whole
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE, TRUTH
from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.core.rules import CONTROL_CLASSES, PROTOCOLS
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.core.working_folder import working_folder
from dynahoi_lerobot.evaluate import replay_results
from dynahoi_lerobot.evaluate.arguments import TRAINED_FOR, VLM, add_trust_argument, make_actor, playing_rules
from dynahoi_lerobot.evaluate.results import WEIGHTS, Results, RunInfo, command_line, read_results
from dynahoi_lerobot.evaluate.table import kind_table, results_table
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.inference import INFERENCE_MODES, MAX_LATENCY_MS, SYNC, Inference, RealTimeAgent
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.fingerprint import surroundings
from dynahoi_lerobot.sampling.recipe import PLAYING, Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import SMALL_TEST, split_seeds, stream_label
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, PROMPTS
from dynahoi_lerobot.world.batch import WorldBatch

RECIPE_OPTIONS = tuple(name for name in PLAYING if name not in ("split", "views"))
"""Fields of the recipe that are options of the command; the policy decides the views."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi evaluate``."""
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument(
        "--replay",
        type=path,
        metavar="RESULTS",
        help="re-execute the commands of a result folder and compare all numbers",
    )
    task.add_argument(
        "--policy",
        help=f"checkpoint folder, Hub repository, vlm, or a privileged baseline: expert, {', '.join(EXPERTS.names())}",
    )
    parser.add_argument("--split", default=SMALL_TEST, help="test, test_small, val, twins or one of the ood_ splits")
    parser.add_argument("--out", type=path, help="result folder; an incomplete one is resumed")
    parser.add_argument(
        "--episodes",
        type=int,
        help="number of episodes: the first of the split, or random ones with --replay; all by default",
    )
    parser.add_argument(
        "--replay-seed",
        type=whole(0, 2**32 - 1),
        help="with --replay: seed of the draw, as printed by an earlier replay",
    )
    state = f"by default what the policy reads; {TRUTH} must be given, and makes it privileged"
    add_field_arguments(parser, Recipe, RECIPE_OPTIONS, environment_state=state, **TRAINED_FOR)
    parser.add_argument(
        "--batch-size",
        type=whole(1, 4096),
        default=32,
        help="worlds simulated in parallel, without effect on results; 1 for policies with --inference-ms measured",
    )
    parser.add_argument("--gifs", type=whole(0, 10**6), default=0, help="number of episodes to record as GIFs in --out")
    parser.add_argument("--per-kind", action="store_true", help="also print a row for each kind of motion")
    _add_policy_arguments(parser)


def _add_policy_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what concerns LeRobot policies and vision-language models."""
    parser.add_argument("--device", help="torch device of the policy")
    add_trust_argument(parser)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a field of the policy's config, such as n_action_steps=2; dictionaries as JSON; may be repeated",
    )
    parser.add_argument(
        "--inference",
        choices=INFERENCE_MODES,
        default=SYNC,
        help="; ".join(f"{mode}: {meaning}" for mode, meaning in INFERENCE_MODES.items()),
    )
    parser.add_argument(
        "--inference-ms",
        type=_latency,
        default=0.0,
        metavar="MS",
        help="with --inference async or rtc: inference time [ms], or measured for the time on this machine",
    )
    parser.add_argument("--model", help="with --policy vlm: model name at the endpoint")
    parser.add_argument("--prompt", default=DEFAULT_PROMPT, help=f"with --policy vlm: prompt, {' or '.join(PROMPTS)}")
    parser.add_argument(
        "--base-url",
        help="with --policy vlm: URL of an OpenAI-compatible endpoint; its key is read from OPENAI_API_KEY",
    )
    parser.add_argument(
        "--request-timeout",
        type=number(0.001, 86_400.0),
        default=60.0,
        help="with --policy vlm: time limit of a decision with all its requests [s]",
    )


def _latency(text: str) -> float | None:
    """Parse ``--inference-ms``; None is ``measured``."""
    return None if text == "measured" else number(0.0, MAX_LATENCY_MS)(text)


def run(args: argparse.Namespace) -> int:
    """Evaluate, write the results and print them; return the exit code."""
    if args.replay_seed is not None and not args.replay:
        raise ValueError(f"--replay-seed {args.replay_seed} is for --replay RESULTS")
    if args.replay:
        return replay_results.run(args)
    inference = Inference(args.inference, args.inference_ms)
    actor = _real_time(_actor(args), inference)
    rules = playing_rules(given_fields(args, RECIPE_OPTIONS), actor)
    recipe = Recipe(split=args.split, views=actor.views, **rules)
    if inference.mode != SYNC and recipe.control_mode != JOINTS:
        raise ValueError(f"--inference {inference.mode} needs control_mode {JOINTS!r}, got {recipe.control_mode!r}")
    info = RunInfo(
        actor.name if args.policy == VLM else args.policy,
        stream_label(args.split, recipe.salt),
        recipe.capture,
        command_line(sys.argv),
        recipe.fingerprint(),
        {
            "recipe": recipe.stored(),
            "inference": inference.label,
            "settings": args.set,
            "privileged": actor.privileged,
            "surroundings": surroundings(),
            WEIGHTS: dict(actor.weights),
        },
    )
    with working_folder(args.out, info.task()) if args.out else nullcontext():
        results = Results.resumed(args.out, info) if args.out else Results(Path(), info)
        specs = _specs(args, recipe, results.seeds)
        args.batch_size = _batch_size(args, inference)
        for episodes in _played(args, recipe, actor, specs):
            results = results.plus(episodes)
            info.extra.update(actor.report())
            if args.out:
                results.write()
        if not specs:
            results = _finished(results)
    print(results_table([results]))
    if args.policy == VLM:
        print("\n" + ", ".join(f"{name} {value}" for name, value in info.extra.get(VLM, {}).items()))
    if args.per_kind:
        print("\n" + kind_table(results).as_text())
    return 0


def _finished(results: Results) -> Results:
    """Return results of which nothing was left to play, as they are if they are whole."""
    with suppress(ReadError):
        return read_results(results.folder)
    results.write()  # the earlier run ended between the renaming of two files
    return results


def _real_time(actor: Actor, inference: Inference) -> Actor:
    """Give the actor an inference that takes time."""
    if inference.mode == SYNC:
        return actor
    if not isinstance(actor, ChunkAgent):
        raise ValueError(f"--inference {inference.mode} needs a policy that plans chunks; {actor.name!r} is an expert")
    return RealTimeAgent(actor, inference)


def _batch_size(args: argparse.Namespace, inference: Inference) -> int:
    """Return how many worlds are played together: one where the time of a LeRobot policy's inference is measured.

    Such a policy infers for all worlds at once, which takes longer than for one robot. VLMs are asked world by world.
    """
    measured = inference.mode != SYNC and inference.latency_ms is None
    return 1 if measured and args.policy != VLM else args.batch_size


def _actor(args: argparse.Namespace) -> Actor:
    actor = (
        _vlm(args)
        if args.policy == VLM and not args.set
        else make_actor(args.policy, args.capture or Recipe.capture, args.device, args.set, trust=args.trust)
    )
    if actor.environment_state == TRUTH and args.environment_state is None:
        raise ValueError(
            f"{args.policy} reads {ENVIRONMENT_STATE}, the simulator's truth; add --environment-state {TRUTH} to let "
            "it: its results are then marked as privileged"
        )
    if args.environment_state is not None and args.environment_state != actor.environment_state:
        needed = f"--environment-state {actor.environment_state}" if actor.environment_state else "none; leave it out"
        raise ValueError(f"--environment-state is {args.environment_state!r}, but {args.policy} needs {needed}")
    return actor


def _vlm(args: argparse.Namespace) -> Agent:
    """Return the vision-language model that the arguments name."""
    from dynahoi_lerobot.vlm.agent import VlmAgent, VlmClient

    if not args.model:
        raise ValueError("--policy vlm needs --model NAME, and --base-url URL unless the model is OpenAI's")
    if args.protocol and known("protocol", args.protocol, PROTOCOLS).blind_control:
        raise ValueError(f"--policy vlm decides by what it sees while acting, which is nothing under {args.protocol}")
    control = known("control class", args.control_class or Recipe.control_class, CONTROL_CLASSES)
    client = VlmClient(
        args.model,
        args.base_url,
        timeout_s=args.request_timeout,
        prompt=args.prompt,
        palm_speed_m_s=CAPTURES[args.capture or Recipe.capture].palm_speed_m_s(control),
        log=args.out / "vlm.jsonl" if args.out else None,
    )
    return VlmAgent(client, name=f"vlm:{args.model}:{args.prompt}")


def _specs(args: argparse.Namespace, recipe: Recipe, played: set[int]) -> list[EpisodeSpec]:
    """Sample the episodes whose seeds are not among those ``played`` before."""
    seeds = split_seeds(args.split)
    if args.episodes is not None:
        if not 1 <= args.episodes <= len(seeds):
            raise ValueError(f"--episodes must be 1 to {len(seeds)}, all of split {args.split}; got {args.episodes}")
        seeds = seeds[: args.episodes]
    return sample_specs(recipe, [seed for seed in seeds if seed not in played], threads=0)


def _played(
    args: argparse.Namespace, recipe: Recipe, actor: Actor, specs: list[EpisodeSpec]
) -> Iterator[list[Episode]]:
    """Play the episodes ``specs`` and yield them batch by batch, without images; the first are written as GIFs."""
    if not specs:
        return
    batch = WorldBatch(recipe, min(args.batch_size, len(specs)))
    gifs = args.gifs if args.out else 0
    with tqdm(total=len(specs), desc=f"{args.policy} on {args.split}", unit="episode") as progress:
        for group in batched(specs, args.batch_size):
            if len(group) < batch.size:  # a policy's noise depends on the number of worlds, also when it is resumed
                batch = WorldBatch(recipe, len(group))
            played = []
            for episode in evaluate(batch, actor, group, images=gifs > 0):
                if gifs > 0:
                    from dynahoi_lerobot.evaluate.gif import episode_gif  # which brings in OpenCV

                    episode_gif(args.out / f"{episode.meta.motion}_{episode.meta.seed}.gif", episode)
                    gifs -= 1
                played.append(replace(episode, images={}))
                progress.update()
            yield played
