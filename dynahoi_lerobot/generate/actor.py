"""The policy that moves the hand in on-policy recordings: named by the content of its checkpoint,
alone on the CPU.

Nothing here imports torch before a policy is loaded.
"""

import hashlib
from functools import cache
from pathlib import Path

import dynahoi_lerobot
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE
from dynahoi_lerobot.core.reading import read_object, sha256
from dynahoi_lerobot.evaluate.actors import EXPERT_ALIAS
from dynahoi_lerobot.evaluate.checkpoint import checked_folder
from dynahoi_lerobot.evaluate.checkpoint_files import (
    ADAPTER,
    CONFIG,
    WEIGHTS,
    PolicyError,
    base_folder,
)
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.sampling.fingerprint import hash_packages

POLICY_SOURCES = ("evaluate/policy_agent.py", "core/lerobot_internals.py")
"""Source between a policy and the worlds; no expert passes there."""
PARTS = (CONFIG, ADAPTER, "policy_*.json", "*.safetensors")
"""Files of a checkpoint from which a policy and its processors are loaded, besides the weights of
an adapter's base."""


def open_policy(path: str, *, trust: bool = False) -> PolicyAgent:
    """Load a policy on the CPU.

    Raises:
        PolicyError: if there is no such policy, if it reads ``observation.environment_state``, if
            a repository is to be trusted, whose content would not be named, or if loading it could
            run code of its own, unless ``trust`` allows that.
    """
    if path in (EXPERT_ALIAS, *EXPERTS.names()):
        raise PolicyError(
            f"an actor is a checkpoint, got the baseline {path!r}; --expert NAME records one"
        )
    if trust and not Path(path).is_dir():
        raise PolicyError(
            f"--trust needs a folder as the actor, got {path!r}; download the repository first"
        )
    policy = PolicyAgent(path, "cpu", trust=trust)
    if policy.environment_state != "":
        raise PolicyError(
            f"{path} reads {ENVIRONMENT_STATE}; an actor sees images and the hand alone"
        )
    return policy


@cache
def _opened(path: str, name: str, on: str, trust: bool) -> PolicyAgent:
    """Load a policy once in a process, if it is still the one of that name, and this machine acts
    to the same bits.
    """
    policy = open_policy(path, trust=trust)
    for found, wanted in ((actor_name(path), name), (runtime(policy), on)):
        if found != wanted:
            raise PolicyError(
                f"the checkpoint {path} is {found} here; the recording is of {wanted}"
            )
    return policy


def make_actor(seed: int, *, path: str, name: str, on: str, trust: bool = False) -> PolicyAgent:
    """Return the policy at ``path`` with the random numbers of a seed, and let torch use one
    thread: with more, sums may be rounded in another order.

    Raises:
        PolicyError: if its ``actor_name`` is not ``name``, or its ``runtime`` here is not ``on``.
    """
    import torch

    torch.set_num_threads(1)
    policy = _opened(path, name, on, trust)
    policy.seed = seed
    return policy


def actor_name(path: str) -> str:
    """Return ``TYPE@HASH`` of a checkpoint that can be loaded: its policy's type, 16 digits of its
    files' sha256.
    """
    folder = Path(path) if Path(path).is_dir() else checked_folder(path)
    digest = hashlib.sha256()
    for file in sorted({file for part in PARTS for file in folder.glob(part)}):
        digest.update(file.name.encode())
        digest.update(bytes.fromhex(sha256(file)))
    base = base_folder(folder)
    if base is not None:
        digest.update(bytes.fromhex(sha256(base / WEIGHTS)))
    return f"{read_object(folder / CONFIG, {'type': str})['type']}@{digest.hexdigest()[:16]}"


def runtime(policy: PolicyAgent) -> str:
    """Return what besides its checkpoint decides the bits of what a policy does: libraries,
    processor, sources.
    """
    import lerobot
    import torch

    sources = hashlib.sha256(hash_packages({policy.package} - {"lerobot"}))
    for source in POLICY_SOURCES:
        sources.update((Path(dynahoi_lerobot.__file__).parent / source).read_bytes())
    capability = torch.backends.cpu.get_cpu_capability()
    return (
        f"torch {torch.__version__}, lerobot {lerobot.__version__}, {capability}, "
        f"{sources.hexdigest()[:16]}"
    )
