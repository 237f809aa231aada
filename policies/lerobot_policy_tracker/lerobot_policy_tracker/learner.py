"""A policy that acts in a simulation and learns there from a teacher's labels, without writing a dataset.

The eye is frozen, so each image is looked at once, while acting. Updates then run over whole episodes: every frame is a
decision, and all decisions of an episode share its tokens.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import draccus
import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.envs.utils import preprocess_observation
from torch import Tensor

from dynahoi_lerobot.core.agent import Plan
from dynahoi_lerobot.core.features import as_gym
from dynahoi_lerobot.onpolicy.student import Learner

from .configuration_tracker import TrackerConfig
from .correction import Expectation
from .decisions import Decisions, window_decisions
from .frames import EncodedFrames
from .heads.base import Forecast, ForecastHead
from .lesson import Lesson
from .modeling_tracker import TrackerPolicy
from .observation import Batch, Observation
from .processor_tracker import make_tracker_pre_post_processors
from .updates import learning_rate, take_step

if TYPE_CHECKING:
    from dynahoi_lerobot.core.agent import Observation as WorldObservation
    from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe
    from dynahoi_lerobot.onpolicy.rounds import Round

__all__ = ["TrackerLearner", "make_learner"]

WARMUP_UPDATES = 50
ON_POLICY = "on-policy"
"""What stands for a dataset in the checkpoint's ``train_config.json``: there was none."""


class TrackerLearner(Learner):
    """See `dynahoi_lerobot.onpolicy.student.Learner`.

    Args:
        policy: with a backbone that is an eye, and a head that forecasts.
        recipe: how it is trained.
    """

    def __init__(self, policy: TrackerPolicy, recipe: DaggerRecipe) -> None:
        self.policy, self.recipe = policy, recipe
        self.preprocess, self.postprocess = make_tracker_pre_post_processors(policy.config)
        self.lessons: deque[Lesson] = deque(maxlen=recipe.rounds_kept)
        config = policy.config
        self.optimizer = torch.optim.AdamW(
            policy.get_optim_params(), lr=0.0, betas=config.optimizer_betas, weight_decay=config.optimizer_weight_decay
        )
        self.generator = torch.Generator().manual_seed(recipe.seed)
        self.n_updates = 0
        self.accepts_prefix, self.corrects = policy.accepts_prefix, policy.corrects
        self.reset(0)

    # -- acting ---------------------------------------------------------------------------------------------------

    def reset(self, count: int) -> None:
        """Begin new episodes."""
        self.policy.reset()
        self.policy.eval()
        self._looks: list[Tensor] = []
        self._proprioception: list[Tensor] = []
        self._chunks: list[Tensor] = [torch.empty(0)] * count
        self._lead_frames = torch.zeros(count, dtype=torch.long, device=self.policy.config.device)

    @torch.no_grad()
    def act(self, observation: WorldObservation) -> np.ndarray:
        """Return (N, 18) commands as the policy alone would, and keep what was seen."""
        batch, frame, looks = self._look(observation)
        return self.postprocess(self.policy.select_action_after(frame, looks, batch)).numpy()

    @torch.no_grad()
    def watch(self, observation: WorldObservation) -> None:
        """Keep what was seen."""
        _, frame, looks = self._look(observation)
        self.policy.planner.history.append(self.policy.encode_looks(frame, looks))

    @torch.no_grad()
    def plan(
        self,
        observation: WorldObservation,
        worlds: np.ndarray,
        *,
        executed: np.ndarray | None = None,
        delays: np.ndarray | None = None,
    ) -> Plan:
        """Return a chunk for each of ``worlds`` (n,), which continues what is executed until it is ready."""
        self.watch(observation)
        delays = np.zeros_like(worlds) if delays is None else delays
        leftover = None if executed is None else self._leftover(worlds, executed, int(delays.max()))
        length = torch.from_numpy(delays).to(self.policy.config.device)
        chunks = self.policy.plan_after(worlds.tolist(), leftover, length)
        self._lead_frames[worlds] = length + length // 2
        for i, chunk in zip(worlds, chunks, strict=True):
            self._chunks[i] = chunk
        expectations = self.policy.expectations(list(range(len(worlds)))) if self.corrects else ()
        return Plan(self.postprocess(chunks).numpy(), np.zeros(len(worlds)), expectations)

    def corrected(self, worlds: np.ndarray, expectations: Sequence[Expectation], ages: Sequence[int]) -> np.ndarray:
        """Return (n, 18) commands for the frame that was noted last, in place of those of chunks."""
        return self.postprocess(self.policy.corrected_action(worlds.tolist(), list(expectations), list(ages))).numpy()

    def _leftover(self, worlds: np.ndarray, executed: np.ndarray, n_steps: int) -> Tensor:
        """Return (n, n_steps, A) what is to come of each old chunk, its last action repeated where it is over."""
        chunks = [self._chunks[i] for i in worlds]
        places = [
            torch.arange(done, done + n_steps).clamp_max(len(chunk) - 1)
            for done, chunk in zip(executed, chunks, strict=True)
        ]
        return torch.stack([chunk[place] for chunk, place in zip(chunks, places, strict=True)])

    def _look(self, observation: WorldObservation) -> tuple[Batch, Observation, Tensor]:
        """Return a frame as a batch, as the policy reads it, and the look at its images."""
        batch: Batch = self.preprocess(preprocess_observation(as_gym(observation)) | {"task": list(observation.tasks)})
        frame = self.policy.planner.observe(batch)
        looks = self.policy.model.look(frame)
        self._looks.append(looks)
        self._proprioception.append(frame.proprioception)
        return batch, frame, looks

    # -- learning -------------------------------------------------------------------------------------------------

    def study(self, played: Round) -> None:
        """Keep a round that was just acted."""
        lesson = Lesson.of(played, self._looks, self._proprioception)
        self.lessons.append(self._tracked(lesson.seen_ahead(self._lead_frames)))

    def learn(self, updates: int) -> float:
        """Update the policy; return the mean loss.

        Raises:
            FloatingPointError: if the loss is not finite.
        """
        self.policy.train()
        return float(np.mean([self._update(self._draw()) for _ in range(updates)]))

    def loss(self, lesson: Lesson) -> Tensor:
        """Return the mean loss over all frames of a lesson, a scalar."""
        model = self.policy.model
        frames, decisions = self._decisions(lesson, wanted=lesson.keep)
        assert lesson.track is not None, "lessons that are kept have one"
        condition = model.conditions(frames, decisions, lesson.track.map(decisions.pick))
        palm = condition.position[:, None, :3]
        label = Forecast(decisions.pick(lesson.path) - palm, decisions.pick(lesson.closed))
        arrival, known = decisions.pick(lesson.arrival), decisions.pick(lesson.known)
        return model.head.forecast_loss(label, condition, arrival, known).mean()

    def _decisions(self, lesson: Lesson, wanted: Tensor | None = None) -> tuple[EncodedFrames, Decisions]:
        """Return the frames of a lesson, and a decision at each of them, or at those wanted ``(B, T)``."""
        model, config = self.policy.model, self.policy.config
        no_images = lesson.looks[..., :0]
        observation = Observation(
            no_images, lesson.proprioception, lesson.state, lesson.keep, lesson.watching, lesson.texts
        )
        frames = model.encode_looks(observation, lesson.looks)
        windows = torch.arange(lesson.keep.shape[1])[:, None] + torch.tensor(config.windows.lookback)  # (T, W)
        return frames, window_decisions(frames, windows, config, wanted)

    @torch.no_grad()
    def _tracked(self, lesson: Lesson) -> Lesson:
        """Return the lesson with its track, which no update changes, so that it is fitted once."""
        track = self.policy.model.track(*self._decisions(lesson))
        assert track is not None
        return replace(lesson, track=track.map(lambda x: x.unflatten(0, lesson.keep.shape)))

    def _update(self, lesson: Lesson) -> float:
        recipe, policy, n = self.recipe, self.policy, self.n_updates
        rate = learning_rate(recipe.learning_rate, n, recipe.rounds * recipe.updates, WARMUP_UPDATES)
        max_norm = policy.config.optimizer_grad_clip_norm
        clipped = policy.model.parameters()
        loss = take_step(self.optimizer, self.loss(lesson), clipped, max_norm=max_norm, rate=rate, n=n)
        policy.update()
        self.n_updates += 1
        return loss

    def _draw(self) -> Lesson:
        """Draw episodes of one of the rounds kept."""
        lesson = self.lessons[int(torch.randint(len(self.lessons), (), generator=self.generator))]
        order = torch.randperm(len(lesson.texts), generator=self.generator)
        return lesson.rows(order[: self.recipe.batch_episodes].tolist())

    # -- saving ---------------------------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Return all that learning goes on from."""
        return {
            "policy": self.policy.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "updates": self.n_updates,
            "lessons": [{**lesson.tensors(), "texts": lesson.texts} for lesson in self.lessons],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self.policy.load_state_dict(state["policy"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"])
        self.n_updates = state["updates"]
        device = self.policy.config.device
        self.lessons.extend(self._tracked(Lesson(**lesson).to(device)) for lesson in state["lessons"])

    def save_pretrained(self, folder: Path) -> None:
        """Write the policy, averaged weights alone, and its processors, as LeRobot opens them."""
        acting = self.policy.for_acting()
        acting.save_pretrained(folder)
        recipe = self.recipe
        steps, dataset = recipe.rounds * recipe.updates, DatasetConfig(repo_id=ON_POLICY)
        TrainPipelineConfig(
            dataset, policy=acting.config, seed=recipe.seed, steps=steps, batch_size=recipe.batch_episodes
        ).save_pretrained(folder)
        for pipeline in (self.preprocess, self.postprocess):
            pipeline.save_pretrained(folder)


def make_learner(recipe: DaggerRecipe) -> TrackerLearner:
    """Return the learner of a recipe's policy, at the weights of its ``start``, if any, or else at random ones.

    Raises:
        ValueError: if the policy cannot learn this way, or its config is not valid.
    """
    torch.manual_seed(recipe.seed)
    config = cast(TrackerConfig, draccus.decode(PreTrainedConfig, recipe.policy))
    policy = TrackerPolicy.from_pretrained(recipe.start, config=config) if recipe.start else TrackerPolicy(config)
    policy.to(config.device)
    if not (policy.model.backbone.locates and isinstance(policy.model.head, ForecastHead)):
        raise ValueError(
            f"only backbones that locate the target and heads that forecast learn on-policy, such as eye and "
            f"intercept, got {config.backbone!r} and {config.head!r}"
        )
    return TrackerLearner(policy, recipe)
