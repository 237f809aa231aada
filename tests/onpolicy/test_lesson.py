"""Labels of a round: the path ahead, until the hand touches the target."""

from __future__ import annotations

import numpy as np
import torch
from lerobot_policy_tracker.heads.intercept import KNOTS
from lerobot_policy_tracker.lesson import Lesson

from dynahoi_lerobot.onpolicy.rounds import Round

N_FRAMES = 6


def played(target_x: list[float], released: list[bool]) -> Round:
    """Return a round of one episode: a hand that stays at home, a target on the x axis whose path is 1 cm a frame."""
    target = np.zeros((1, N_FRAMES, 3), np.float32)
    target[0, :, 0] = target_x
    path = np.zeros((100, 3), np.float32)
    path[:, 0] = 0.01 * np.arange(100)
    everywhere = np.ones((1, N_FRAMES), bool)
    return Round(
        state=np.zeros((1, N_FRAMES, 18), np.float32),
        watching=~everywhere,
        playing=everywhere,
        released=np.array([released]),
        target=target,
        path=(path,),
        closed=np.zeros((1, 15), np.float32),
        arrival=np.ones((1, N_FRAMES), int),
        tasks=("catch",),
        episodes=(),
    )


def lesson(round_: Round) -> Lesson:
    seen = [torch.zeros(1, 1, 1, 2)] * N_FRAMES
    return Lesson.of(round_, seen, [torch.zeros(1, 1, 18)] * N_FRAMES)


def test_the_path_is_known_until_the_target_is_touched_and_where_it_lies_in_the_hand():
    taught = lesson(played([0.0, 0.01, 0.02, 0.03, 0.03, 1.0], [False, False, False, True, True, True]))
    before, held, gone = 1, 4, 5
    torch.testing.assert_close(taught.path[0, before, :, 0], 0.01 * (before + torch.tensor(KNOTS)))
    assert taught.known[0, before].all()
    assert (taught.path[0, held, :, 0] == 0.03).all()
    assert taught.known[0, held].all()
    assert not taught.known[0, gone].any(), "nobody knows where a target goes that bounced off the hand"
