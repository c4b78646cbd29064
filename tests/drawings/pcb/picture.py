"""A picture of a board, both layers seen from the side of the parts, as SVG."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final
from xml.sax.saxutils import escape

from tests.drawings.pcb.layout import Board, Layer, Pad, Point

SCALE: Final = 14.0
MARGIN: Final = 2.0
COPPER: Final = {"top": "#c0392b", "bottom": "#2c6fbb"}


def picture(board: Board) -> str:
    """The board's SVG."""
    width, height = (SCALE * (one + 2 * MARGIN) for one in board.size)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'font-family="DejaVu Sans, Helvetica, sans-serif" font-size="{0.9 * SCALE:g}">',
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>',
        *_rectangle(board, (0.0, 0.0, *board.size), 'fill="#f4f1e6" stroke="#111111" stroke-width="2"'),
        *_copper(board, "bottom"),
        *_copper(board, "top"),
    ]
    edge = 'fill="#ffffff" stroke="#111111" stroke-width="2"'
    lines += [_circle(board, hole.at, hole.drill, edge) for hole in board.holes]
    for via in board.vias:
        lines.append(_circle(board, via.at, via.size, 'fill="#777777"'))
        lines.append(_circle(board, via.at, via.drill, 'fill="#ffffff"'))
    for _, pad in board.pads():
        lines += _pad(board, pad)
    for part in board.parts:
        lines += _rectangle(board, part.courtyard, 'fill="none" stroke="#333333" stroke-dasharray="4 3"')
        x, y = _at(board, part.at)
        lines.append(
            f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle" font-weight="bold">{escape(part.name)}</text>'
        )
    return "\n".join([*lines, "</svg>", ""])


def _copper(board: Board, layer: Layer) -> Iterator[str]:
    for track in board.tracks:
        if track.layer == layer:
            (x1, y1), (x2, y2) = _at(board, track.start), _at(board, track.end)
            yield (
                f'<path d="M{x1:.1f} {y1:.1f} L{x2:.1f} {y2:.1f}" stroke="{COPPER[layer]}" stroke-linecap="round" '
                f'stroke-width="{track.width * SCALE:.1f}" opacity="0.8"/>'
            )


def _pad(board: Board, pad: Pad) -> Iterator[str]:
    colour = "#b8860b" if pad.net else "#bbbbbb"
    if pad.is_round:
        yield _circle(board, pad.at, pad.size[0], f'fill="{colour}"')
    else:
        (x, y), (w, h) = pad.at, pad.size
        yield from _rectangle(board, (x - w / 2, y - h / 2, x + w / 2, y + h / 2), f'fill="{colour}" opacity="0.75"')
    if pad.drill:
        yield _circle(board, pad.at, pad.drill, 'fill="#ffffff"')


def _rectangle(board: Board, box: tuple[float, float, float, float], style: str) -> Iterator[str]:
    x, y = _at(board, (box[0], box[3]))
    yield (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{(box[2] - box[0]) * SCALE:.1f}" '
        f'height="{(box[3] - box[1]) * SCALE:.1f}" {style}/>'
    )


def _circle(board: Board, at: Point, diameter: float, style: str) -> str:
    x, y = _at(board, at)
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{diameter * SCALE / 2:.1f}" {style}/>'


def _at(board: Board, point: Point) -> Point:
    return SCALE * (MARGIN + point[0]), SCALE * (MARGIN + board.size[1] - point[1])
