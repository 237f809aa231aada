"""Dataset aggregation through LeRobot datasets on disk: generate, merge, ``lerobot-train`` resumed, evaluate; again.

    python -m recipes.train.dagger_rounds recipes/train/standard.yaml --out outputs/rounds

It takes a recipe of ``dynahoi dagger``, which does the same in memory: a round plays ``worlds`` episodes, of them
``teacher_share`` led by the teacher, in the first round all, and makes ``updates`` steps, here on batches of frames.
All datasets so far are learned from. Kinds of motion that the policy failed get more of the next episodes. Each step
that is done has a line in ``log.jsonl``, so the same command goes on after any interruption.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import yaml

from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.onpolicy.curriculum import failure_rate
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, read_recipe
from recipes.study.run import dynahoi, run

LOG, TRAINING = "log.jsonl", "training"


def main() -> None:
    """Run the rounds that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe", type=Path)
    parser.add_argument("--out", type=Path, default=Path("outputs/rounds"))
    parser.add_argument("--batch-size", type=int, default=64, help="frames in a step")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rounds = Rounds(read_recipe(DaggerRecipe, args.recipe), args.out, args.batch_size)
    for number in range(rounds.recipe.rounds):
        rounds.play(number)


class Rounds:
    """The rounds of a recipe in a folder.

    Attributes:
        recipe: what to do.
        out: folder with the datasets, the training and the log.
        batch_size: frames in a step of training.
    """

    def __init__(self, recipe: DaggerRecipe, out: Path, batch_size: int) -> None:
        """Prepare the rounds; those that a stopped run has done are in its log."""
        self.recipe, self.out, self.batch_size = recipe, out, batch_size
        self.done = {(line["round"], line["step"]) for line in read_log(out / LOG)}

    def play(self, number: int) -> None:
        """Do what is left of a round, from 0."""
        self._once(number, "generate", self._generate)
        self._once(number, "merge", self._merge)
        self._once(number, "train", self._train)
        if (number + 1) % self.recipe.validate_every == 0 or number + 1 == self.recipe.rounds:
            self._once(number, "evaluate", self._evaluate)

    def _once(self, number: int, step: str, do: Callable[[int], None]) -> None:
        """Do a step unless the log has it, and log the processor time that it took [s]."""
        if (number, step) in self.done:
            return
        start = processor_s()
        do(number)
        line = {"round": number, "step": step, "processor_seconds": round(processor_s() - start, 1)}
        with (self.out / LOG).open("a") as file:
            file.write(json.dumps(line) + "\n")

    def _generate(self, number: int) -> None:
        recipe = self.recipe
        episodes = {key: value for key, value in asdict(recipe.episodes).items() if value}
        (self.out / "episodes.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(episodes))))
        what = ["--recipe", self.out / "episodes.yaml", "--root", self.dataset(number)]
        what += ["--episodes", recipe.worlds, "--seed", number * recipe.worlds, "--shard-episodes", recipe.worlds]
        if number:
            kinds = allotted(recipe.episodes.motion_names, *self._failures(number - 1))
            what += ["--actor", self.checkpoint(number - 1), "--motions", ",".join(kinds)]
        dynahoi("generate", *map(str, what), "--teacher-share", str(recipe.teacher_share if number else 1))

    def _merge(self, number: int) -> None:
        if not self.merged(number).exists():
            merge([self.dataset(i) for i in range(number + 1)], self.merged(number))

    def _train(self, number: int) -> None:
        """Train up to the round's last step, from the checkpoint of the round before."""
        training, steps = self.out / TRAINING, (number + 1) * self.recipe.updates
        changes = [f"--dataset.root={self.merged(number)}", f"--steps={steps}", f"--save_freq={steps}"]
        if number:
            changes += [f"--config_path={self.checkpoint(number - 1) / 'train_config.json'}", "--resume=true"]
        else:
            shutil.rmtree(training, ignore_errors=True)  # of a run that was interrupted
            (self.out / "train.yaml").write_text(yaml.safe_dump(self._training(training)))
            changes += [f"--config_path={self.out / 'train.yaml'}"]
        run([sys.executable, "-m", "lerobot.scripts.lerobot_train", *changes], self.out / f"train-{number}.log")

    def _training(self, training: Path) -> dict[str, Any]:
        """Return the configuration of ``lerobot-train``; the learning rate is constant, as the end comes in rounds."""
        recipe, rate = self.recipe, self.recipe.learning_rate
        labels = {"privileged_key": "target.pose", "privileged_weight": 0.0}
        rates = {"optimizer_lr": rate, "scheduler_decay_lr": rate, "scheduler_warmup_steps": 1}
        return {
            "dataset": {"repo_id": "local/rounds"},
            "output_dir": str(training),
            "batch_size": self.batch_size,
            "num_workers": 0,
            "env_eval_freq": 0,
            "seed": recipe.seed,
            "policy": recipe.policy | labels | rates,
        }

    def _evaluate(self, number: int) -> None:
        recipe, episodes = self.recipe, self.recipe.episodes
        what = ["--policy", self.checkpoint(number), "--split", "val", "--episodes", recipe.validation_episodes]
        what += ["--control-class", episodes.control_class, "--capture", episodes.capture]
        dynahoi("evaluate", *map(str, what), "--out", str(self.out / f"val-{number}"))

    def _failures(self, number: int) -> tuple[list[str], list[bool]]:
        """Return kind and success of each episode of a round that the policy led."""
        files = sorted((self.dataset(number) / "meta/episodes").glob("*/*.parquet"))
        rows = [
            row
            for file in files
            for row in pq.read_table(file, columns=["motion", "agent", "actor", "success"]).to_pylist()
        ]
        led = [row for row in rows if row["agent"] == row["actor"]]
        return [row["motion"] for row in led], [row["success"] for row in led]

    def dataset(self, number: int) -> Path:
        """Return the folder of a round's episodes."""
        return self.out / f"data-{number}"

    def merged(self, number: int) -> Path:
        """Return the folder of all episodes up to a round."""
        return self.out / f"data-0-{number}"

    def checkpoint(self, number: int) -> Path:
        """Return the checkpoint that a round ends with."""
        return self.out / TRAINING / "checkpoints" / f"{(number + 1) * self.recipe.updates:06d}" / "pretrained_model"


def allotted(kinds: list[str], played: list[str], caught: list[bool]) -> list[str]:
    """Return as many kinds of motion as there are, those that fail more often than others repeated, in order.

    Args:
        kinds: what may be played.
        played: kinds of the episodes that were.
        caught: which of them succeeded.
    """
    results = {kind: [success for name, success in zip(played, caught, strict=True) if name == kind] for kind in kinds}
    rates = np.array([failure_rate(r.count(True), r.count(False)) for r in results.values()])
    edges = np.cumsum(rates) / rates.sum() * len(kinds)
    return [kinds[int(np.searchsorted(edges, place + 0.5))] for place in range(len(kinds))]


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return the log's lines; one that a kill has cut off is dropped from the file."""
    whole = (
        [line for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")] if path.exists() else []
    )
    if path.exists():
        path.write_text("".join(whole))
    return [json.loads(line) for line in whole]


def processor_s() -> float:
    """Return the processor time of this process and of those it waited for [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


if __name__ == "__main__":
    main()
