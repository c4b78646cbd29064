"""What a board house asks for: Gerber files with X2 attributes, Excellon drills, lists of parts and of their places."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

from tests.drawings.pcb.layout import LAYERS, Board, Pad, Point

MASK_MM: Final = 0.05
"""The solder mask stays away from a pad by this."""

FUNCTIONS: Final = {
    "top": "Copper,L1,Top", "bottom": "Copper,L2,Bot", "mask-top": "Soldermask,Top", "mask-bottom": "Soldermask,Bot",
    "paste-top": "Paste,Top", "silk-top": "Legend,Top", "outline": "Profile,NP",
}  # fmt: skip
Flash = tuple[str, float, float, Point]
Line = tuple[float, Point, Point]


def files(board: Board) -> dict[str, str]:
    """Text of every file to send, by its name."""
    made = {}
    for layer in LAYERS:
        pads = [_flash(pad) for _, pad in board.pads() if layer in pad.layers]
        vias: list[Flash] = [("C", via.size, via.size, via.at) for via in board.vias]
        lines = [(track.width, track.start, track.end) for track in board.tracks if track.layer == layer]
        made[layer] = _gerber(board, layer, pads + vias, lines)
        masked = [_flash(pad, 2 * MASK_MM) for _, pad in board.pads() if layer in pad.layers]
        made[f"mask-{layer}"] = _gerber(board, f"mask-{layer}", masked, [])
    made["paste-top"] = _gerber(board, "paste-top", [_flash(pad) for _, pad in board.pads() if not pad.drill], [])
    made["silk-top"] = _gerber(board, "silk-top", [], list(_legend(board)))
    width, height = board.size
    corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height), (0.0, 0.0)]
    made["outline"] = _gerber(board, "outline", [], [(0.1, *ends) for ends in pairwise(corners)])
    named = {f"{board.name}-{layer}.gbr": text for layer, text in made.items()}
    plated = [(pad.drill, pad.at) for _, pad in board.pads() if pad.drill] + [(via.drill, via.at) for via in board.vias]
    named[f"{board.name}-plated.drl"] = _drills(plated, "Plated,1,2,PTH")
    named[f"{board.name}-unplated.drl"] = _drills([(hole.drill, hole.at) for hole in board.holes], "NonPlated,1,2,NPTH")
    named[f"{board.name}-places.csv"] = _places(board)
    named[f"{board.name}-parts.csv"] = _parts(board)
    return named


def _flash(pad: Pad, more: float = 0.0) -> Flash:
    return "C" if pad.is_round else "R", pad.size[0] + more, pad.size[1] + more, pad.at


def _legend(board: Board) -> Iterable[Line]:
    """A frame around the room of every part, clear of all pads, with a bar beside pin 1."""
    for part in board.parts:
        x0, y0, x1, y1 = part.courtyard
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
        yield from ((0.12, *ends) for ends in pairwise(corners))
        if len(part.pads) > 2 or "electrolytic" in part.package or "LED" in part.package:
            x, y = part.pads[0].at
            if abs(x - x0) <= abs(y - y1):
                yield 0.3, (x0, y - 0.4), (x0, y + 0.4)
            else:
                yield 0.3, (x - 0.4, y1), (x + 0.4, y1)


def _gerber(board: Board, layer: str, flashes: list[Flash], lines: list[Line]) -> str:
    """One layer in the Gerber format, mm with six decimals."""
    apertures: dict[str, int] = {}

    def number(words: str) -> int:
        return apertures.setdefault(words, 10 + len(apertures))

    drawn: list[str] = []
    for shape, width, height, at in flashes:
        words = f"C,{width:.6f}" if shape == "C" else f"R,{width:.6f}X{height:.6f}"
        drawn += [f"D{number(words)}*", f"{_place(at)}D03*"]
    for width, start, end in lines:
        drawn += [f"D{number(f'C,{width:.6f}')}*", f"{_place(start)}D02*", f"{_place(end)}D01*"]
    return "\n".join(
        [
            f"%TF.FileFunction,{FUNCTIONS[layer]}*%",
            "%TF.FilePolarity,Negative*%" if layer.startswith("mask") else "%TF.FilePolarity,Positive*%",
            f"G04 Retrograph, {board.name}, {layer}*",
            "%FSLAX46Y46*%",
            "%MOMM*%",
            "%LPD*%",
            *(f"%ADD{code}{words}*%" for words, code in apertures.items()),
            "G01*",
            *drawn,
            "M02*",
            "",
        ]
    )


def _place(at: Point) -> str:
    return f"X{round(at[0] * 1e6)}Y{round(at[1] * 1e6)}"


def _drills(holes: list[tuple[float, Point]], function: str) -> str:
    """Holes in the Excellon format, mm."""
    sizes = sorted({size for size, _ in holes})
    lines = ["M48", f"; #@! TF.FileFunction,{function}", "FMAT,2", "METRIC"]
    lines += [f"T{tool}C{size:.3f}" for tool, size in enumerate(sizes, 1)]
    lines += ["G90", "%", "G05"]
    for tool, size in enumerate(sizes, 1):
        lines.append(f"T{tool}")
        lines += [f"X{x:.4f}Y{y:.4f}" for one, (x, y) in holes if one == size]
    return "\n".join([*lines, "M30", ""])


def _places(board: Board) -> str:
    """Pick and place: the parts that a machine sets; wired ones are soldered by hand and said so."""
    lines = ["designator,value,package,x_mm,y_mm,rotation_deg,side,by"]
    for part in board.parts:
        by = "hand" if part.pads[0].drill else "machine"
        lines.append(f'{part.name},"{part.value}","{part.package}",{part.at[0]:.3f},{part.at[1]:.3f},0,top,{by}')
    return "\n".join(lines) + "\n"


def _parts(board: Board) -> str:
    lines = ["designator,value,package"]
    lines += [f'{part.name},"{part.value}","{part.package}"' for part in board.parts]
    return "\n".join(lines) + "\n"
