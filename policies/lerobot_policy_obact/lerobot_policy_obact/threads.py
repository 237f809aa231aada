"""How many of torch's threads ObAct computes with on a CPU: one.

Its networks are small. A thread more saves little on an idle machine, and where other programs
compute, each operation waits until the system has given every thread a core.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import torch


def on_one_thread[**P, R](compute: Callable[P, R]) -> Callable[P, R]:
    """Let a function compute on one thread, and leave torch's number as it was; what runs on a GPU
    does not depend on it.
    """

    @wraps(compute)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return compute(*args, **kwargs)
        finally:
            torch.set_num_threads(threads)

    return call
