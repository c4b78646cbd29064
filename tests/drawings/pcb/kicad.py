"""A board as KiCad 6 reads it, so that its own design rule check judges what ours passed."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from tests.drawings.pcb.layout import Board, Pad, Point

LAYER = {"top": "F.Cu", "bottom": "B.Cu"}


def kicad_board(board: Board) -> str:
    """Text of a .kicad_pcb; y points down there."""
    nets = {net: number for number, net in enumerate(["", *sorted(board.nets())])}
    height = board.size[1]

    def at(point: Point) -> str:
        return f"{point[0]:.4f} {height - point[1]:.4f}"

    def net(name: str) -> str:
        return f'(net {nets[name]} "{name}")'

    return "\n".join(
        [
            '(kicad_pcb (version 20211014) (generator "retrograph")',
            "(general (thickness 1.6)) (paper A4)",
            '(layers (0 "F.Cu" signal) (31 "B.Cu" signal) (34 "B.Paste" user) (35 "F.Paste" user)',
            '(36 "B.SilkS" user) (37 "F.SilkS" user) (38 "B.Mask" user) (39 "F.Mask" user)',
            '(44 "Edge.Cuts" user) (46 "B.CrtYd" user) (47 "F.CrtYd" user) (49 "F.Fab" user))',
            f"(setup (pad_to_mask_clearance 0.05) (grid_origin 0 {height}))",
            *(f'(net {number} "{name}")' for name, number in nets.items()),
            *_parts(board, at, net),
            *_bare_holes(board, at),
            f'(gr_rect (start {at((0.0, 0.0))}) (end {at(board.size)}) (layer "Edge.Cuts") (width 0.1) (fill none))',
            *(
                f"(segment (start {at(track.start)}) (end {at(track.end)}) (width {track.width}) "
                f'(layer "{LAYER[track.layer]}") (net {nets[track.net]}))'
                for track in board.tracks
            ),
            *(
                f'(via (at {at(via.at)}) (size {via.size}) (drill {via.drill}) (layers "F.Cu" "B.Cu") '
                f"(net {nets[via.net]}))"
                for via in board.vias
            ),
            ")",
            "",
        ]
    )


def _parts(board: Board, at: Callable[[Point], str], net: Callable[[str], str]) -> Iterator[str]:
    for part in board.parts:
        kind = "through_hole" if part.pads[0].drill else "smd"
        yield f'(footprint "retrograph:{part.name}" (layer "F.Cu") (at 0 0) (attr {kind})'
        yield f'(fp_text reference "{part.name}" (at {at(part.at)}) (layer "F.Fab") (effects (font (size 1 1))))'
        yield f'(fp_text value "{part.value}" (at {at(part.at)}) (layer "F.Fab") hide (effects (font (size 1 1))))'
        x0, y0, x1, y1 = part.courtyard
        yield f'(fp_rect (start {at((x0, y0))}) (end {at((x1, y1))}) (layer "F.CrtYd") (width 0.05) (fill none))'
        for pad in part.pads:
            yield _pad(pad, at(pad.at), net(pad.net) if pad.net else "")
        yield ")"


def _pad(pad: Pad, place: str, net: str) -> str:
    shape = "circle" if pad.is_round else "rect"
    size = f"(size {pad.size[0]} {pad.size[1]})"
    if pad.drill:
        return (
            f'(pad "{pad.name}" thru_hole {shape} (at {place}) {size} (drill {pad.drill}) (layers *.Cu *.Mask) {net})'
        )
    return f'(pad "{pad.name}" smd {shape} (at {place}) {size} (layers "F.Cu" "F.Paste" "F.Mask") {net})'


def _bare_holes(board: Board, at: Callable[[Point], str]) -> Iterator[str]:
    for number, hole in enumerate(board.holes, 1):
        yield f'(footprint "retrograph:hole" (layer "F.Cu") (at {at(hole.at)})'
        yield f'(fp_text reference "H{number}" (at 0 0) (layer "F.Fab") (effects (font (size 1 1))))'
        yield f'(pad "" np_thru_hole circle (at 0 0) (size {hole.drill} {hole.drill}) '
        yield f"(drill {hole.drill}) (layers *.Cu *.Mask)))"


JUDGE = """
import sys, pcbnew
board = pcbnew.LoadBoard(sys.argv[1])
pcbnew.WriteDRCReport(board, sys.argv[2], pcbnew.EDA_UNITS_MILLIMETRES, True)
"""
"""Run by a Python that has pcbnew: board and report."""
