"""Loops of links: which links are borne out by others, and which to start from.

Going round a loop must lead back. A link that closes loops of three or four presses with others is borne out; links
between the same two presses rule each other out. The presses' first places come from the tree of the links that are
borne out best.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from typing import Final

import numpy as np

from host_sync.mosaic.links import Link
from host_sync.mosaic.motion import Motion

CLOSING_SIGMAS: Final = 5.0
CLOSING_PX: Final = 6.0
"""A loop closes within so many px besides `CLOSING_SIGMAS` of its links: presses are strained a little."""

Step = tuple[int, int, Motion, float]
"""Number of the link, press it leads to, motion, variance of where it puts a middle (px²)."""


def supports(links: list[Link], reach_px: float) -> list[int]:
    """Return how many loops of three or four presses each link closes.

    reach_px : half the diagonal of a press
    """
    steps: dict[int, list[Step]] = defaultdict(list)
    for number, link in enumerate(links):
        variance = link.sigma_px**2 + (reach_px**2) * float(link.covariance[2, 2])
        steps[link.first].append((number, link.second, link.motion, variance))
        steps[link.second].append((number, link.first, link.motion.back(), variance))
    counts = [0] * len(links)
    for start in sorted(steps):
        ways: dict[int, list[tuple[tuple[int, ...], int, Motion, float]]] = defaultdict(list)
        for number, end, motion, variance in steps[start]:
            if end > start:
                ways[end].append(((number,), -1, motion, variance))
            for more, last, further, added in steps[end]:
                if last > start and last != start:
                    ways[last].append(((number, more), end, motion.then(further), variance + added))
        for found in ways.values():
            for one, other in itertools.combinations(found, 2):
                if one[1] == other[1] or set(one[0]) & set(other[0]):
                    continue
                limit = CLOSING_PX + CLOSING_SIGMAS * float(np.sqrt(one[3] + other[3]))
                if one[2].distance_px(other[2], 0.5 * reach_px) <= limit:
                    for number in (*one[0], *other[0]):
                        counts[number] += 1
    return counts


def first_places(links: list[Link], counts: list[int], presses: int) -> tuple[dict[int, Motion], int]:
    """Motions of the presses of the largest linked group into the mosaic, and its root.

    The tree takes links in the order of the loops that they close, then of their strength.
    """
    group = list(range(presses))

    def head(press: int) -> int:
        while group[press] != press:
            press = group[press]
        return press

    tree: dict[int, list[tuple[int, Motion]]] = defaultdict(list)
    order = sorted(range(len(links)), key=lambda number: (-min(counts[number], 3), -links[number].strength))
    for number in order:
        link = links[number]
        one, other = head(link.first), head(link.second)
        if one != other:
            group[other] = one
            tree[link.first].append((link.second, link.motion))
            tree[link.second].append((link.first, link.motion.back()))
    heads = [head(press) for press in range(presses)]
    largest = max(set(heads), key=lambda one: (heads.count(one), -one))
    members = [press for press in range(presses) if heads[press] == largest]
    root = max(members, key=lambda press: (len(tree[press]), -press))
    places = {root: Motion()}
    waiting = [root]
    while waiting:
        press = waiting.pop()
        for near, motion in tree[press]:
            if near not in places:
                # `motion` leads from the press to its neighbour, a place leads from a press to the mosaic.
                places[near] = motion.back().then(places[press])
                waiting.append(near)
    return places, root
