"""Rules that a board house and the parts ask for, checked on the geometry of a board.

Every piece of copper is a core (a point, a segment or an upright rectangle) and a radius around it, so that distances
are exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from tests.drawings.pcb.layout import LAYERS, Board, Box, Layer, Point

CLEARANCE_MM: Final = 0.2
EDGE_MM: Final = 0.3
RING_MM: Final = 0.15
HOLE_MM: Final = 0.25
LEAST_TRACK_MM: Final = 0.2
LEAST_DRILL_MM: Final = 0.3
TOUCH_MM: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Copper:
    """A piece of copper: what it is, its net, layers, core and radius."""

    what: str
    net: str
    layers: tuple[Layer, ...]
    core: Box
    radius: float
    is_box: bool = False

    @property
    def box(self) -> Box:
        """Its bounds."""
        x0, y0, x1, y1 = self.core
        r = self.radius
        return min(x0, x1) - r, min(y0, y1) - r, max(x0, x1) + r, max(y0, y1) + r

    def edges(self) -> list[tuple[Point, Point]]:
        """The segments that bound the core."""
        x0, y0, x1, y1 = self.core
        if not self.is_box:
            return [((x0, y0), (x1, y1))]
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        return [(corners[i], corners[(i + 1) % 4]) for i in range(4)]


def coppers(board: Board) -> list[Copper]:
    """All copper of a board."""
    found = []
    for part, pad in board.pads():
        (x, y), (w, h) = pad.at, pad.size
        what = f"{part}.{pad.name}"
        if pad.is_round:
            found.append(Copper(what, pad.net, pad.layers, (x, y, x, y), w / 2))
        else:
            found.append(Copper(what, pad.net, pad.layers, (x - w / 2, y - h / 2, x + w / 2, y + h / 2), 0.0, True))
    found += [Copper(f"via at {via.at}", via.net, LAYERS, (*via.at, *via.at), via.size / 2) for via in board.vias]
    for track in board.tracks:
        what = f"track at {track.start}"
        found.append(Copper(what, track.net, (track.layer,), (*track.start, *track.end), track.width / 2))
    return found


def distance(one: Copper, other: Copper) -> float:
    """Between the edges of two pieces, mm; 0 or less when they touch."""
    for this, that in ((one, other), (other, one)):
        if this.is_box:
            x0, y0, x1, y1 = this.core
            (x, y) = that.core[:2]
            if x0 <= x <= x1 and y0 <= y <= y1:
                return -one.radius - other.radius
    between = min(_segments(a, b) for a in one.edges() for b in other.edges())
    return between - one.radius - other.radius


def complaints(board: Board) -> list[str]:
    """What breaks a rule, in words; empty when nothing does."""
    pieces = coppers(board)
    return [
        *_clearances(pieces),
        *_unconnected(board, pieces),
        *_edges(board, pieces),
        *_holes(board, pieces),
        *_sizes(board),
        *_courtyards(board),
    ]


def _clearances(pieces: list[Copper]) -> Iterator[str]:
    for one, other in combinations(pieces, 2):
        if (one.net and one.net == other.net) or not set(one.layers) & set(other.layers) or _far(one.box, other.box):
            continue
        gap = distance(one, other)
        if gap < CLEARANCE_MM - TOUCH_MM:
            yield f"{one.what} ({one.net}) is {gap:.3f} mm from {other.what} ({other.net})"


def _unconnected(board: Board, pieces: list[Copper]) -> Iterator[str]:
    """Nets whose pads are not all joined by copper."""
    for net, pads in sorted(board.nets().items()):
        own = [piece for piece in pieces if piece.net == net]
        joined, waiting = {0}, [0]
        while waiting:
            here = own[waiting.pop()]
            for number, there in enumerate(own):
                near = number not in joined and set(here.layers) & set(there.layers)
                if near and not _far(here.box, there.box) and distance(here, there) <= TOUCH_MM:
                    joined.add(number)
                    waiting.append(number)
        left = sorted(one.what for number, one in enumerate(own) if number not in joined)
        if left:
            yield f"{net}: {', '.join(left)} are not joined to {own[0].what} ({len(pads)} pins)"


def _edges(board: Board, pieces: list[Copper]) -> Iterator[str]:
    width, height = board.size
    for piece in pieces:
        x0, y0, x1, y1 = piece.box
        if min(x0, y0, width - x1, height - y1) < EDGE_MM - TOUCH_MM:
            yield f"{piece.what} is nearer than {EDGE_MM} mm to the board's edge"


def _holes(board: Board, pieces: list[Copper]) -> Iterator[str]:
    for hole in board.holes:
        bored = Copper("hole", "", LAYERS, (*hole.at, *hole.at), hole.drill / 2)
        for piece in pieces:
            if distance(bored, piece) < HOLE_MM - TOUCH_MM:
                yield f"{piece.what} is nearer than {HOLE_MM} mm to the hole at {hole.at}"
    drills = [(hole.at, hole.drill) for hole in board.holes]
    drills += [(pad.at, pad.drill) for _, pad in board.pads() if pad.drill]
    drills += [(via.at, via.drill) for via in board.vias]
    for (at, one), (there, other) in combinations(drills, 2):
        if math.dist(at, there) - (one + other) / 2 < HOLE_MM - TOUCH_MM:
            yield f"the holes at {at} and {there} are nearer than {HOLE_MM} mm to each other"


def _sizes(board: Board) -> Iterator[str]:
    for part, pad in board.pads():
        if pad.drill and (min(pad.size) - pad.drill) / 2 < RING_MM:
            yield f"{part}.{pad.name}: the ring around its hole is thinner than {RING_MM} mm"
    for via in board.vias:
        if (via.size - via.drill) / 2 < RING_MM or via.drill < LEAST_DRILL_MM:
            yield f"via at {via.at}: ring or hole is too small"
    for track in board.tracks:
        if track.width < LEAST_TRACK_MM:
            yield f"track at {track.start} is thinner than {LEAST_TRACK_MM} mm"


def _courtyards(board: Board) -> Iterator[str]:
    for one, other in combinations(board.parts, 2):
        a, b = one.courtyard, other.courtyard
        if a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]:
            yield f"{one.name} and {other.name} take the same room"


def _far(a: Box, b: Box, gap: float = 1.0) -> bool:
    return a[0] > b[2] + gap or b[0] > a[2] + gap or a[1] > b[3] + gap or b[1] > a[3] + gap


def _segments(one: tuple[Point, Point], other: tuple[Point, Point]) -> float:
    """Distance of two segments."""
    (a, b), (c, d) = one, other
    if _side(a, b, c) * _side(a, b, d) < 0 and _side(c, d, a) * _side(c, d, b) < 0:
        return 0.0
    return min(_to_segment(a, c, d), _to_segment(b, c, d), _to_segment(c, a, b), _to_segment(d, a, b))


def _side(a: Point, b: Point, p: Point) -> float:
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _to_segment(p: Point, a: Point, b: Point) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    squared = dx * dx + dy * dy
    t = 0.0 if squared == 0.0 else max(0.0, min(1.0, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / squared))
    return math.dist(p, (a[0] + t * dx, a[1] + t * dy))
