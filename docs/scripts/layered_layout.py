"""Layered drawing of a directed graph without cycles: which row and which place in it every node gets.

The steps are those of Sugiyama, Tagawa and Toda (1981): rows by longest path, long links cut by a bend in each row they
pass, few crossings by sorting each row by the mean place of its neighbours, places that keep links straight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

Links = dict[str, set[str]]
"""Node -> the nodes that it points to."""

SWEEPS = 24
STRAIGHTNESS = 8.0
"""How much more a bend wants to lie straight between bends than a node between its neighbours."""


def reachable(links: Links, node: str) -> set[str]:
    """Return every node to which a path leads from ``node``."""
    found: set[str] = set()
    waiting = list(links[node])
    while waiting:
        if (other := waiting.pop()) not in found:
            found.add(other)
            waiting.extend(links[other])
    return found


def transitive_reduction(links: Links) -> Links:
    """Return the fewest links that leave the same nodes reachable from each node."""
    behind = {node: reachable(links, node) for node in links}
    return {node: {o for o in others if not any(o in behind[p] for p in others)} for node, others in links.items()}


@dataclass(frozen=True)
class Layout:
    """Where everything is drawn.

    Attributes:
        row: of every node and bend; links lead to lower rows, and a node without links is in row 0.
        place: across the page, of every node and bend.
        chains: for every link its nodes and bends, from its tail to its head.
    """

    row: dict[str, int]
    place: dict[str, float]
    chains: list[list[str]]

    @classmethod
    def of(cls, links: Links, gap: Callable[[str, str], float]) -> Self:
        """Lay a graph out.

        Args:
            links: every node, in the order that decides ties.
            gap: least distance of the places of two neighbours in a row; bends have names that no node has.
        """
        row: dict[str, int] = {}
        for node in _heads_first(links):
            row[node] = max((row[other] + 1 for other in links[node]), default=0)
        chains = [_chain(node, other, row) for node in links for other in sorted(links[node], key=list(links).index)]
        near = _neighbours(chains)
        rows = _ordered(row, near, chains)
        return cls(row, _placed(rows, near, links, gap), chains)


def _heads_first(links: Links) -> list[str]:
    done: list[str] = []

    def visit(node: str) -> None:
        for other in sorted(links[node]):
            if other not in done:
                visit(other)
        if node not in done:
            done.append(node)

    for node in links:
        visit(node)
    return done


def _chain(tail: str, head: str, row: dict[str, int]) -> list[str]:
    """Cut a link by a bend in every row between; their rows are added to ``row``."""
    bends = {f"{tail}>{head}@{level}": level for level in range(row[tail] - 1, row[head], -1)}
    row.update(bends)
    return [tail, *bends, head]


def _neighbours(chains: Iterable[Sequence[str]]) -> dict[str, list[str]]:
    near: dict[str, list[str]] = {}
    for a, b in (pair for chain in chains for pair in pairwise(chain)):
        near.setdefault(a, []).append(b)
        near.setdefault(b, []).append(a)
    return near


def _ordered(row: dict[str, int], near: dict[str, list[str]], chains: list[list[str]]) -> list[list[str]]:
    """Sort every row by the mean position of its neighbours, down and up; return the best of all tries."""
    rows = [[node for node in row if row[node] == level] for level in range(max(row.values()) + 1)]
    best, fewest = rows, _crossings(rows, row, chains)
    for sweep in range(SWEEPS):
        step = 1 if sweep % 2 == 0 else -1
        rows = [list(nodes) for nodes in rows]
        for level in range(len(rows))[::step]:
            at = {node: i / len(nodes) for nodes in rows for i, node in enumerate(nodes)}
            sides = {n: [at[m] for m in near[n] if (row[m] - level) * step < 0] or [at[n]] for n in rows[level]}
            rows[level].sort(key=lambda node, sides=sides: sum(sides[node]) / len(sides[node]))
        if (count := _crossings(rows, row, chains)) < fewest:
            best, fewest = rows, count
    return best


def _crossings(rows: list[list[str]], row: dict[str, int], chains: list[list[str]]) -> int:
    at = {node: i for nodes in rows for i, node in enumerate(nodes)}
    spans = [
        [(at[a], at[b]) for chain in chains for a, b in pairwise(chain) if row[a] == level] for level in row.values()
    ]
    return sum((a - c) * (b - d) < 0 for pairs in spans for a, b in pairs for c, d in pairs)


def _placed(
    rows: list[list[str]], near: dict[str, list[str]], links: Links, gap: Callable[[str, str], float]
) -> dict[str, float]:
    """Move every node towards the mean of its neighbours, as far as its row has room."""
    place = {
        node: float(x) for nodes in rows for node, x in zip(nodes, _spread(nodes, [0.0] * len(nodes), gap), strict=True)
    }
    for _ in range(SWEEPS):
        for nodes in (*rows, *rows[::-1]):
            wanted = [_mean(node, place, near[node], links) for node in nodes]
            place.update(zip(nodes, _spread(nodes, wanted, gap), strict=True))
    return place


def _mean(node: str, place: dict[str, float], near: list[str], links: Links) -> float:
    weights = [1.0 if node in links or other in links else STRAIGHTNESS for other in near]
    return sum(w * place[other] for w, other in zip(weights, near, strict=True)) / sum(weights)


def _spread(nodes: list[str], wanted: list[float], gap: Callable[[str, str], float]) -> list[float]:
    """Return the places closest to the ``wanted`` ones that keep order and gaps (isotonic regression)."""
    offsets = [0.0]
    for a, b in pairwise(nodes):
        offsets.append(offsets[-1] + gap(a, b))
    blocks: list[list[float]] = []
    for target in (want - offset for want, offset in zip(wanted, offsets, strict=True)):
        blocks.append([target])
        while len(blocks) > 1 and _average(blocks[-2]) > _average(blocks[-1]):
            blocks[-2:] = [blocks[-2] + blocks[-1]]
    places = [_average(block) for block in blocks for _ in block]
    return [place + offset for place, offset in zip(places, offsets, strict=True)]


def _average(values: list[float]) -> float:
    return sum(values) / len(values)
