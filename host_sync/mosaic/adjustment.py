"""The places of all presses together: weighted least squares over the links, without those that do not fit.

Loops of links: which links are borne out by others, and which to start from.

Going round a loop must lead back. A link that closes loops of three or four presses with others is borne out; links
between the same two presses rule each other out. The presses' first places come from the tree of the links that are
borne out best.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.align import QUARTER, Pose, turning
from device.surface import Float64Array
from host_sync.mosaic.links import Link

FLOOR_PX: Final = 0.3
"""What a link's place is uncertain by besides its own σ, px: gels are strained differently at each press."""

FLOOR_TURN: Final = 2e-4
"""The same of its turn, rad."""

REJECTED_SIGMAS: Final = 6.0
"""A link that is further off than this is a wrong overlap."""

ROUNDS: Final = 30
STEPS: Final = 4
SETTLED_PX: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Places of the presses.

    places : of each press, its pose in the mosaic (px of a press); None where nothing links it to the others
    used : of each link, whether it took part
    loops : of each link, how many loops of three or four presses it closes
    residual_px : of each link, how far it is off; NaN where a press has no place
    residual_sigmas : the same over its uncertainty
    covariance : float64 array of shape (3 N, 3 N) of all places (row and column, px; turn, rad) relative to the root's;
        0 of presses without a place
    root : the press that the others are relative to
    """

    places: list[Pose | None]
    used: list[bool]
    loops: list[int]
    residual_px: list[float]
    residual_sigmas: list[float]
    covariance: Float64Array
    root: int

    def distance_sigma_px(self, one: int, other: int) -> float:
        """Return the standard uncertainty of the distance of two presses' middles, px."""
        start, end = self.places[one], self.places[other]
        if start is None or end is None:
            return float("nan")
        way = np.array([end.down - start.down, end.right - start.right])
        way = way / max(float(np.linalg.norm(way)), 1e-12)
        design = np.zeros(len(self.covariance))
        design[3 * one : 3 * one + 2] -= way
        design[3 * other : 3 * other + 2] += way
        return float(np.sqrt(max(float(design @ self.covariance @ design), 0.0)))


def adjusted(links: list[Link], presses: int, reach_px: float) -> Adjusted:
    """Return the places of the presses.

    links : that were not refused by themselves
    presses : number of presses
    reach_px : half the diagonal of a press
    """
    counts = supports(links, reach_px)
    places, root = first_places(links, counts, presses)
    inside = [number for number, link in enumerate(links) if link.first in places and link.second in places]
    used = set(_near(links, inside, places, reach_px))
    for _ in range(ROUNDS):
        places, _ = _solved(links, sorted(used), places, root)
        off = {number: _sigmas(links[number], places) for number in inside}
        fitting = _one_a_pair(links, {number for number in inside if off[number] <= REJECTED_SIGMAS}, off)
        worse = used - fitting
        # The worst alone goes: it pulls others with it.
        changed = (used | fitting) - worse if len(worse) <= 1 else used - {max(worse, key=lambda one: off[one])}
        changed = _connecting(links, changed, used, root, places)
        if changed == used:
            break
        used = changed
    places, covariance = _solved(links, sorted(used), places, root)
    full = np.zeros((3 * presses, 3 * presses))
    known = sorted(places)
    index = np.array([3 * press + axis for press in known for axis in range(3)])
    full[np.ix_(index, index)] = covariance
    return Adjusted(
        [places.get(press) for press in range(presses)],
        [number in used for number in range(len(links))],
        counts,
        [_residual_px(link, places) for link in links],
        [_sigmas(link, places) for link in links],
        full,
        root,
    )


def _near(links: list[Link], inside: list[int], places: dict[int, Pose], reach_px: float) -> list[int]:
    """Return the links that roughly agree with first places: a tree adds up the errors of its links."""
    return [number for number in inside if _residual_px(links[number], places) <= 0.05 * reach_px]


def _one_a_pair(links: list[Link], fitting: set[int], off: dict[int, float]) -> set[int]:
    """Return one link of each pair of presses, the nearest."""
    best: dict[tuple[int, int], int] = {}
    for number in sorted(fitting, key=lambda one: off[one]):
        best.setdefault((links[number].first, links[number].second), number)
    return set(best.values())


def _connecting(links: list[Link], wanted: set[int], before: set[int], root: int, places: dict[int, Pose]) -> set[int]:
    """Return the wanted links, and of those before them what still is needed to reach every press."""
    kept = set(wanted)
    while True:
        reached, grew = {root}, True
        while grew:
            grew = False
            for number in kept:
                ends = {links[number].first, links[number].second}
                if len(ends & reached) == 1:
                    reached |= ends
                    grew = True
        lost = set(places) - reached
        bridges = [n for n in before - kept if len({links[n].first, links[n].second} & reached) == 1]
        if not lost or not bridges:
            return kept
        kept.add(max(bridges, key=lambda number: links[number].strength))


def _weight(link: Link) -> Float64Array:
    covariance = link.covariance + np.diag([FLOOR_PX**2, FLOOR_PX**2, FLOOR_TURN**2])
    return np.asarray(np.linalg.inv(covariance), np.float64)


def _rest(link: Link, places: dict[int, Pose]) -> Float64Array:
    """Return what the link says less what the places say: (row, column) px, turn rad."""
    one, other = places[link.first], places[link.second]
    said = other.back().of(one.of(link.here))
    # A place leads to the mosaic: the turn of a press is minus that of its place.
    turn = (link.turn + other.turn - one.turn + np.pi) % (2.0 * np.pi) - np.pi
    return np.array([*(link.there - said), turn])


def _residual_px(link: Link, places: dict[int, Pose]) -> float:
    if link.first not in places or link.second not in places:
        return float("nan")
    return float(np.hypot(*_rest(link, places)[:2]))


def _sigmas(link: Link, places: dict[int, Pose]) -> float:
    if link.first not in places or link.second not in places:
        return float("nan")
    rest = _rest(link, places)
    return float(np.sqrt(rest @ _weight(link) @ rest))


def _solved(
    links: list[Link], used: list[int], places: dict[int, Pose], root: int
) -> tuple[dict[int, Pose], Float64Array]:
    """Return the least-squares places from those given, and their covariance in the order of the presses' numbers."""
    order = {press: number for number, press in enumerate(sorted(places))}
    count = 3 * len(order)
    free = np.array([at for at in range(count) if at // 3 != order[root]], int)
    covariance = np.zeros((count, count))
    for _ in range(STEPS):
        normal, right = np.zeros((count, count)), np.zeros(count)
        chi = 0.0
        for number in used:
            link = links[number]
            one, other = places[link.first], places[link.second]
            rest, weight = _rest(link, places), _weight(link)
            back = turning(-other.turn)
            # said = M(-turn_b) (t_a + M(turn_a) here - t_b)
            of_first, of_second = np.zeros((3, 3)), np.zeros((3, 3))
            of_first[:2, :2], of_second[:2, :2] = back, -back
            of_first[:2, 2] = back @ QUARTER @ turning(one.turn) @ link.here
            of_second[:2, 2] = -QUARTER @ other.back().of(one.of(link.here))
            of_first[2, 2], of_second[2, 2] = 1.0, -1.0
            design = np.zeros((3, count))
            at_first, at_second = 3 * order[link.first], 3 * order[link.second]
            design[:, at_first : at_first + 3] = of_first
            design[:, at_second : at_second + 3] = of_second
            columns = np.r_[at_first : at_first + 3, at_second : at_second + 3]
            part = design[:, columns]
            normal[np.ix_(columns, columns)] += part.T @ weight @ part
            right[columns] += part.T @ weight @ rest
            chi += float(rest @ weight @ rest)
        if not free.size:
            return places, covariance
        inverse = np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)
        change = np.zeros(count)
        change[free] = inverse @ right[free]
        places = {press: pose.moved_by(*change[3 * order[press] :][:3]) for press, pose in places.items()}
        over = max(chi / max(3 * len(used) - free.size, 1), 1.0)
        covariance[np.ix_(free, free)] = inverse * over
        if float(np.abs(change).max()) < SETTLED_PX:
            break
    return places, covariance


CLOSING_SIGMAS: Final = 5.0
CLOSING_PX: Final = 6.0
"""A loop closes within so many px besides `CLOSING_SIGMAS` of its links: presses are strained a little."""

Step = tuple[int, int, Pose, float]
"""Number of the link, press it leads to, pose, variance of where it puts a middle (px²)."""


def supports(links: list[Link], reach_px: float) -> list[int]:
    """Return how many loops of three or four presses each link closes.

    reach_px : half the diagonal of a press
    """
    steps: dict[int, list[Step]] = defaultdict(list)
    for number, link in enumerate(links):
        variance = link.sigma_px**2 + (reach_px**2) * float(link.covariance[2, 2])
        steps[link.first].append((number, link.second, link.pose, variance))
        steps[link.second].append((number, link.first, link.pose.back(), variance))
    counts = [0] * len(links)
    for start in sorted(steps):
        ways: dict[int, list[tuple[tuple[int, ...], int, Pose, float]]] = defaultdict(list)
        for number, end, pose, variance in steps[start]:
            if end > start:
                ways[end].append(((number,), -1, pose, variance))
            for more, last, further, added in steps[end]:
                if last > start and last != start:
                    ways[last].append(((number, more), end, pose.then(further), variance + added))
        for found in ways.values():
            for one, other in itertools.combinations(found, 2):
                if one[1] == other[1] or set(one[0]) & set(other[0]):
                    continue
                limit = CLOSING_PX + CLOSING_SIGMAS * float(np.sqrt(one[3] + other[3]))
                if one[2].distance(other[2], 0.5 * reach_px) <= limit:
                    for number in (*one[0], *other[0]):
                        counts[number] += 1
    return counts


def first_places(links: list[Link], counts: list[int], presses: int) -> tuple[dict[int, Pose], int]:
    """Return poses of the presses of the largest linked group in the mosaic, and its root.

    The tree takes links in the order of the loops that they close, then of their strength.
    """
    group = list(range(presses))

    def head(press: int) -> int:
        while group[press] != press:
            press = group[press]
        return press

    tree: dict[int, list[tuple[int, Pose]]] = defaultdict(list)
    order = sorted(range(len(links)), key=lambda number: (-min(counts[number], 3), -links[number].strength))
    for number in order:
        link = links[number]
        one, other = head(link.first), head(link.second)
        if one != other:
            group[other] = one
            tree[link.first].append((link.second, link.pose))
            tree[link.second].append((link.first, link.pose.back()))
    heads = [head(press) for press in range(presses)]
    largest = max(set(heads), key=lambda one: (heads.count(one), -one))
    members = [press for press in range(presses) if heads[press] == largest]
    root = max(members, key=lambda press: (len(tree[press]), -press))
    places = {root: Pose()}
    waiting = [root]
    while waiting:
        press = waiting.pop()
        for near, pose in tree[press]:
            if near not in places:
                # `pose` leads from the press to its neighbour, a place leads from a press to the mosaic.
                places[near] = pose.back().then(places[press])
                waiting.append(near)
    return places, root
