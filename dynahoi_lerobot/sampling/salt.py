"""What a salt makes of a stream of episodes, how streams are named, and which results must not be
mixed.

A salted seed stream is the same benchmark with other episodes, which only those who know the salt
can make. Whoever compares policies of others keeps a salt, evaluates them on episodes that nobody
could train on, and publishes results. What is written to disk names the salt by a hash, so that
results of one salt can be compared with each other and are never mixed with those of the public
stream.
"""

import hashlib
import struct
from collections.abc import Iterable, Sequence
from itertools import pairwise

SEALED = "sha256:"
"""A salt that begins so is the hash of an unknown one, as files hold it."""
LEAST_LENGTH = 16
"""Characters; a hash does not hide a salt that can be guessed."""
HASH_DIGITS = 16
JOINT = "+"
PUBLIC = "none"
OPTIONS = ("--salt", "--env.salt")
HIDDEN = "(hidden)"


def check_salt(salt: str) -> None:
    """Refuse a salt that could be guessed.

    Raises:
        ValueError: if it has 1 to 15 characters; the message does not repeat it.
    """
    if 0 < len(salt) < LEAST_LENGTH:
        raise ValueError(
            f"a salt must have at least {LEAST_LENGTH} characters, or be empty, got {len(salt)}"
        )


def seal(salt: str) -> str:
    """Return what files say instead of a salt: its hash, or an empty text for the public stream."""
    if not salt or salt.startswith(SEALED):
        return salt
    return (
        SEALED
        + hashlib.sha256(b"dynahoi salt, published" + salt.encode()).hexdigest()[:HASH_DIGITS]
    )


def salt_words(salt: str) -> list[int]:
    """Return the numbers that go into the random numbers besides stream and seed; none without a
    salt.

    They come from another hash than ``seal``'s, or whoever reads a result could make its episodes.

    Raises:
        ValueError: for a sealed salt.
    """
    if salt.startswith(SEALED):
        raise ValueError(
            f"these episodes are of the salted stream {salt}; only those who know its salt can "
            f"make them"
        )
    digest = hashlib.sha256(b"dynahoi salt, drawn from" + salt.encode()).digest()
    return list(struct.unpack(">8I", digest)) if salt else []


def stream_label(split: str, salt: str) -> str:
    """Return how episodes and results name their split: with the first digits of the salt's hash,
    if there is one.
    """
    return split + JOINT + seal(salt).removeprefix(SEALED)[:8] if salt else split


def split_of(label: str) -> str:
    """Return the split's name in a ``stream_label``."""
    return label.partition(JOINT)[0]


def refuse_to_mix(noun: str, found: Iterable[tuple[object, str]], remedy: str) -> None:
    """Check that all things have one value of ``noun``.

    Args:
        noun: what must agree, such as ``benchmark``.
        found: pairs of a thing's name and its value.
        remedy: what to do instead, the end of the sentence.

    Raises:
        ValueError: naming the first thing and one that differs, with both values.
    """
    pairs = list(found)
    for name, value in pairs[1:]:
        if value != pairs[0][1]:
            raise ValueError(
                f"{pairs[0][0]} has {noun} {pairs[0][1]!r}, {name} has {noun} {value!r}; {remedy}"
            )


def refuse_mixed_streams(found: Iterable[tuple[object, str]]) -> None:
    """Refuse results of different salts, or of a salt and the public stream.

    Raises:
        ValueError: naming two, by their names in ``found``, whose ``stream_label`` there do not go
            together.
    """
    streams = [(where, label.partition(JOINT)[2] or PUBLIC) for where, label in found]
    refuse_to_mix("salt", streams, "evaluate both with one salt, or without")


def without_salt(words: Sequence[str]) -> list[str]:
    """Return the words of a command line, of this project or of LeRobot, with the salt hidden."""
    hidden = [HIDDEN if before in OPTIONS else word for before, word in pairwise(["", *words])]
    joined = tuple(f"{option}=" for option in OPTIONS)
    return [
        f"{word.split('=')[0]}={HIDDEN}" if word.startswith(joined) else word for word in hidden
    ]
