"""Lays the tracks of a board on two layers and writes them to board/pcb, to be kept with the source.

usage: python -m tests.drawings.pcb.route carrier

Shortest paths on a grid, net by net; a net that finds no way goes first in the next attempt.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from tests.drawings.pcb.designs import FOLDER, carrier
from tests.drawings.pcb.layout import Board, Point, Track, Via
from tests.drawings.pcb.rules import EDGE_MM, HOLE_MM, Copper, coppers

GRID_MM: Final = 0.1625
GAP_MM: Final = 0.23
"""Clearance that is kept while laying: a little more than the rule, for corners."""

SIGNAL_MM, POWER_MM = 0.25, 0.4
POWER: Final = {"GND", "5V", "3V3"}
VIA_COST: Final = 12.0
ATTEMPTS: Final = 12
Mask = NDArray[np.bool_]


class Grid:
    """The nodes of both layers of a board; node = layer * (rows * columns) + row * columns + column."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.columns = int(board.size[0] / GRID_MM) + 1
        self.rows = int(board.size[1] / GRID_MM) + 1
        self.x, self.y = np.meshgrid(np.arange(self.columns) * GRID_MM, np.arange(self.rows) * GRID_MM)
        self.layer = self.columns * self.rows
        index = np.arange(2 * self.layer).reshape(2, self.rows, self.columns)
        pairs = [(index[:, :, :-1], index[:, :, 1:], 1.0), (index[:, :-1], index[:, 1:], 1.0)]
        pairs += [(index[:, :-1, :-1], index[:, 1:, 1:], 2**0.5), (index[:, :-1, 1:], index[:, 1:, :-1], 2**0.5)]
        self.one = np.concatenate([a.ravel() for a, _, _ in pairs])
        self.other = np.concatenate([b.ravel() for _, b, _ in pairs])
        self.cost = np.concatenate([np.full(a.size, cost) for a, _, cost in pairs])

    def within(self, piece: Copper, reach: float) -> Mask:
        """Nodes nearer than `reach` to a piece of copper, of one layer."""
        x0, y0, x1, y1 = piece.core
        if piece.is_box:
            dx = np.maximum(np.maximum(x0 - self.x, self.x - x1), 0.0)
            dy = np.maximum(np.maximum(y0 - self.y, self.y - y1), 0.0)
            return np.hypot(dx, dy) < reach
        ax, ay = x1 - x0, y1 - y0
        squared = ax * ax + ay * ay
        t = np.clip(((self.x - x0) * ax + (self.y - y0) * ay) / squared, 0, 1) if squared else np.zeros_like(self.x)
        return np.hypot(self.x - x0 - t * ax, self.y - y0 - t * ay) < reach + piece.radius

    def free(self, laid: list[Copper], net: str, half: float) -> Mask:
        """Nodes of both layers where copper of that half width may be, shape (2, rows, columns)."""
        width, height = self.board.size
        edge = half + EDGE_MM + 1e-9
        inside = (self.x >= edge) & (self.x <= width - edge) & (self.y >= edge) & (self.y <= height - edge)
        for hole in self.board.holes:
            inside &= np.hypot(self.x - hole.at[0], self.y - hole.at[1]) > hole.drill / 2 + HOLE_MM + 1.0 + half
        found = np.stack([inside, inside])
        for piece in laid:
            if piece.net == net:
                continue
            near = self.within(piece, half + GAP_MM)
            for number, layer in enumerate(("top", "bottom")):
                if layer in piece.layers:
                    found[number] &= ~near
        return found

    def inside(self, piece: Copper, margin: float) -> NDArray[np.intp]:
        """Nodes within a pad or via, on each of its layers."""
        x0, y0, x1, y1 = piece.box
        if piece.is_box:
            fits = (self.x >= x0 + margin) & (self.x <= x1 - margin) & (self.y >= y0 + margin) & (self.y <= y1 - margin)
            if not fits.any():
                fits = self.within(piece, 1e-6)
        else:
            fits = np.hypot(self.x - piece.core[0], self.y - piece.core[1]) <= piece.radius - margin
        nodes = np.flatnonzero(fits)
        return np.concatenate([nodes + (self.layer if layer == "bottom" else 0) for layer in piece.layers])

    def at(self, node: int) -> Point:
        """Place of a node."""
        row, column = divmod(node % self.layer, self.columns)
        return round(column * GRID_MM, 4), round(row * GRID_MM, 4)


def lay_net(grid: Grid, laid: list[Copper], net: str) -> tuple[list[Track], list[Via]] | None:
    """Tracks and vias that join a net's pads; None when one cannot be reached."""
    width = POWER_MM if net in POWER else SIGNAL_MM
    own = [piece for piece in laid if piece.net == net]
    free = grid.free(laid, net, width / 2).ravel()
    pads = [grid.inside(piece, min(0.2, width / 2)) for piece in own]
    through = np.zeros(grid.layer, bool)
    open_via = grid.free(laid, net, Via("", (0, 0)).size / 2).all(axis=0).ravel()
    for piece, nodes in zip(own, pads, strict=True):
        free[nodes] = True
        open_via &= ~grid.within(piece, 0.5).ravel()
        if len(piece.layers) == 2:
            through[nodes[nodes < grid.layer]] = True
    keep = free[grid.one] & free[grid.other]
    flat = np.arange(grid.layer)
    joint = flat[(open_via | through) & free[: grid.layer] & free[grid.layer :]]
    one = np.concatenate([grid.one[keep], joint])
    other = np.concatenate([grid.other[keep], joint + grid.layer])
    cost = np.concatenate([grid.cost[keep], np.where(through[joint], 1e-3, VIA_COST)])
    graph = coo_matrix((cost, (one, other)), shape=(2 * grid.layer,) * 2).tocsr()
    tree, waiting = set(pads[0].tolist()), list(range(1, len(pads)))
    tracks: list[Track] = []
    vias: list[Via] = []
    while waiting:
        length, before, _ = dijkstra(
            graph, directed=False, indices=sorted(tree), return_predecessors=True, min_only=True
        )
        reach = [(length[pads[number]].min(), number) for number in waiting]
        shortest, number = min(reach)
        if not np.isfinite(shortest):
            return None
        waiting.remove(number)
        path = [int(pads[number][np.argmin(length[pads[number]])])]
        while before[path[-1]] >= 0:
            path.append(int(before[path[-1]]))
        tree |= set(path) | set(pads[number].tolist())
        for a, b in pairwise(path):
            if abs(a - b) == grid.layer and not through[a % grid.layer]:
                vias.append(Via(net, grid.at(a)))
        tracks += _straight(grid, path, net, width)
    return tracks, vias


def _straight(grid: Grid, path: list[int], net: str, width: float) -> Iterator[Track]:
    """A path as few straight pieces."""
    start = 0
    for here in range(1, len(path)):
        ends = here == len(path) - 1 or path[here + 1] - path[here] != path[here] - path[here - 1]
        if ends:
            if abs(path[here] - path[start]) != grid.layer:
                layer = "bottom" if path[here] >= grid.layer else "top"
                yield Track(net, layer, grid.at(path[start]), grid.at(path[here]), width)
            start = here


def lay(board: Board) -> tuple[list[Track], list[Via]]:
    """All tracks and vias.

    Raises
    ------
    RuntimeError
        No attempt joined every net: move parts.
    """
    grid = Grid(board)
    spread = {net: len(pins) for net, pins in board.nets().items() if len(pins) > 1}
    order = sorted(spread, key=lambda net: (net in POWER, spread[net]))
    for _ in range(ATTEMPTS):
        laid, tracks, vias, failed = coppers(board), [], [], []
        for net in order:
            found = lay_net(grid, laid, net)
            if found is None:
                failed.append(net)
                continue
            tracks += found[0]
            vias += found[1]
            laid += coppers(Board("", board.size, (), (), tuple(found[1]), tuple(found[0])))
        if not failed:
            return tracks, vias
        sys.stderr.write(f"no way for {', '.join(failed)}\n")
        order = failed + [net for net in order if net not in failed]
    raise RuntimeError(f"{board.name}: no way for {', '.join(failed)}")


def split_at_joints(tracks: list[Track]) -> list[Track]:
    """The same copper in pieces that end wherever another track of the net begins or ends on them."""
    found = []
    for track in tracks:
        ends = {
            end
            for other in tracks
            if (other.net, other.layer) == (track.net, track.layer)
            for end in (other.start, other.end)
        }
        on = sorted((math.dist(track.start, end), end) for end in ends if _is_between(track, end))
        places = [track.start, *(end for _, end in on), track.end]
        found += [replace(track, start=a, end=b) for a, b in pairwise(places)]
    return found


def _is_between(track: Track, point: Point) -> bool:
    length = math.dist(track.start, track.end)
    return (
        point not in {track.start, track.end}
        and abs(math.dist(track.start, point) + math.dist(point, track.end) - length) < 1e-6
    )


def main() -> None:
    """Lay the tracks of the carrier and write them."""
    tracks, vias = lay(carrier(routed=False))
    tracks = split_at_joints(tracks)
    lines = ["net,layer,x1,y1,x2,y2,width"]
    lines += [f"{t.net},{t.layer},{t.start[0]},{t.start[1]},{t.end[0]},{t.end[1]},{t.width}" for t in tracks]
    lines += [f"{via.net},via,{via.at[0]},{via.at[1]},,," for via in vias]
    (FOLDER / "carrier.tracks.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
