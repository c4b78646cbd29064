"""The clear block of the housing as a drawing with dimensions and tolerances, from the housing's own parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.sax.saxutils import escape

SOURCE: Final = Path(__file__).parents[3] / "board" / "enclosure" / "retrograph.scad"
SCALE: Final = 6.0
"""Pixels a millimetre."""

WIDTH, HEIGHT = 980, 780
PLAN: Final = (250.0, 290.0)
SECTION: Final = (700.0, 310.0)
LINE: Final = 'fill="none" stroke="#111111" stroke-width="2"'
THIN: Final = 'fill="none" stroke="#555555" stroke-width="1"'
AXIS: Final = 'fill="none" stroke="#999999" stroke-width="1" stroke-dasharray="12 4 3 4"'
MARKERS: Final = (
    '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" '
    'orient="auto-start-reverse"><path d="M0 2 L10 5 L0 8 Z" fill="#555555"/></marker></defs>'
)

HEIGHT_TOLERANCE_MM: Final = 0.1
RADIUS_TOLERANCE_MM: Final = 0.1
FACET_TOLERANCE_MM: Final = 0.2
FACET_TOLERANCE_DEG: Final = 0.5
WEDGE_MM: Final = 0.05


@dataclass(frozen=True, slots=True)
class Block:
    """Dimensions, mm and degrees; the axis is that of the lens.

    radius : of the round
    height : between the polished faces
    lower, upper : from the axis to a facet, at the lower face (on the gel) and at the upper one
    lean_deg : of a facet from the axis
    azimuths_deg : in which the facets face, red, green, blue
    skin : from the lower face down to the skin
    """

    radius: float
    height: float
    lower: float
    upper: float
    lean_deg: float
    azimuths_deg: tuple[float, ...]
    skin: float

    @classmethod
    def of_source(cls) -> Block:
        """As the housing's source has it."""
        bottom, top = _parameter("gel_thickness"), _parameter("block_top")
        cosine = math.cos(math.radians(_parameter("elevation"))) * _parameter("n_gel") / _parameter("n_block")
        sine = math.sqrt(1.0 - cosine**2)
        facet = _parameter("facet_at")
        return cls(
            radius=_parameter("inner_r") - _parameter("wall") - _parameter("gap"),
            height=top - bottom,
            lower=(facet - bottom * sine) / cosine,
            upper=(facet - top * sine) / cosine,
            lean_deg=math.degrees(math.asin(sine)),
            azimuths_deg=_list("azimuths"),
            skin=bottom,
        )

    def half_chord(self, from_axis: float) -> float:
        """Half the width of a facet where it stands this far from the axis, mm."""
        return math.sqrt(self.radius**2 - from_axis**2)


def block_drawing(block: Block | None = None) -> str:
    """The drawing as SVG text."""
    block = block or Block.of_source()
    body = [*_plan(block), *_section(block), *_notes(block)]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
            'font-family="DejaVu Sans, Helvetica, sans-serif" font-size="13" fill="#111111">',
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
            MARKERS,
            _text(40, 36, "Block, one, cast acrylic (PMMA); all dimensions in mm", 'font-size="18" font-weight="bold"'),
            _text(40, 58, "Made by `make board` from retrograph.scad, which is the source of every dimension."),
            *body,
            "</svg>",
            "",
        ]
    )


def _plan(block: Block) -> Iterator[str]:
    """Seen from above, where the camera is."""
    x, y = PLAN
    radius = block.radius * SCALE
    yield _text(x, 92, "from above", 'text-anchor="middle" font-weight="bold"')
    yield f'<path d="{_outline(block, block.upper)}" {LINE}/>'
    yield f'<path d="{_outline(block, block.lower)}" {LINE}/>'
    yield f'<path d="M{x - radius - 22} {y} H{x + radius + 22} M{x} {y - radius - 22} V{y + radius + 22}" {AXIS}/>'
    for azimuth, name in zip(block.azimuths_deg, ("red", "green", "blue"), strict=True):
        out_x, out_y = _along(azimuth, block.upper * SCALE - 26)
        yield _text(x + out_x, y - out_y + 4, name, 'text-anchor="middle" fill="#555555"')
    # Across the round, below the view; to the red facet's upper edge, at the left.
    yield from _dimension(
        (x - radius, y), (x + radius, y), radius + 62, f"Ø {2 * block.radius:.1f}  0 / −{2 * RADIUS_TOLERANCE_MM:.1f}"
    )
    red_y = y + block.upper * SCALE
    left = x - radius - 20
    yield f'<path d="M{x - block.half_chord(block.upper) * SCALE} {red_y} H{left - 6} M{left - 6} {y} H{x}" {THIN}/>'
    yield _arrow((left, y), (left, red_y))
    yield _text(
        left - 6,
        (y + red_y) / 2,
        f"{block.upper:.2f} ± {FACET_TOLERANCE_MM:.1f}",
        f'text-anchor="middle" transform="rotate(-90 {left - 6:.1f} {(y + red_y) / 2:.1f})"',
    )
    yield _text(x, y + radius + 96, "three facets, 120° ± 0.5° apart, alike", 'text-anchor="middle"')


def _outline(block: Block, from_axis: float) -> str:
    """The round with its three flats, at the height where they stand this far from the axis."""
    x, y = PLAN
    opening = math.degrees(math.acos(from_axis / block.radius))
    corners = []
    for azimuth in sorted(block.azimuths_deg):
        corners += [_along(azimuth - opening, block.radius * SCALE), _along(azimuth + opening, block.radius * SCALE)]
    words = [f"M{x + corners[0][0]:.1f} {y - corners[0][1]:.1f}"]
    for number, (right, up) in enumerate(corners[1:], 1):
        arc = f"A{block.radius * SCALE:.1f} {block.radius * SCALE:.1f} 0 0 0" if number % 2 == 0 else "L"
        words.append(f"{arc} {x + right:.1f} {y - up:.1f}")
    first = corners[0]
    words.append(f"A{block.radius * SCALE:.1f} {block.radius * SCALE:.1f} 0 0 0 {x + first[0]:.1f} {y - first[1]:.1f}")
    return " ".join(words)


def _section(block: Block) -> Iterator[str]:
    """Cut through the axis and the red facet, which is at the right; opposite it is the round."""
    x, base = SECTION
    top = base - block.height * SCALE
    left, lower, upper = (x + span * SCALE for span in (-block.radius, block.lower, block.upper))
    yield _text(x, 92, "cut through the axis and a facet", 'text-anchor="middle" font-weight="bold"')
    yield f'<path d="M{left:.1f} {base} H{lower:.1f} L{upper:.1f} {top:.1f} H{left:.1f} Z" {LINE}/>'
    yield f'<path d="M{x} {top - 40:.1f} V{base + 30}" {AXIS}/>'
    skin = base + block.skin * SCALE
    yield f'<path d="M{left:.1f} {skin} H{lower:.1f}" {THIN} stroke-dasharray="2 3"/>'
    yield _text(left, skin + 15, "skin (no part of the block)", 'font-size="11" fill="#555555"')
    yield from _dimension((x, base), (lower, base), skin - base + 48, f"{block.lower:.2f} ± {FACET_TOLERANCE_MM:.1f}")
    yield from _dimension((x, top), (upper, top), -34.0, f"{block.upper:.2f} ± {FACET_TOLERANCE_MM:.1f}")
    side = left - 26
    yield f'<path d="M{left:.1f} {base} H{side - 6:.1f} M{left:.1f} {top:.1f} H{side - 6:.1f}" {THIN}/>'
    yield _arrow((side, base), (side, top))
    middle = (base + top) / 2
    words = f"{block.height:.1f} ± {HEIGHT_TOLERANCE_MM:.1f}"
    yield _text(side - 8, middle, words, f'text-anchor="middle" transform="rotate(-90 {side - 8:.1f} {middle:.1f})"')
    # The lean from the axis, drawn at the facet's lower edge.
    yield f'<path d="M{lower:.1f} {base} V{top - 14:.1f}" {AXIS}/>'
    reach = 58.0
    lean = math.radians(block.lean_deg)
    end = (lower - reach * math.sin(lean), base - reach * math.cos(lean))
    yield f'<path d="M{lower:.1f} {base - reach} A{reach} {reach} 0 0 0 {end[0]:.1f} {end[1]:.1f}" {THIN}/>'
    yield _text(lower + 8, base - reach - 4, f"{block.lean_deg:.1f}° ± {FACET_TOLERANCE_DEG:.1f}°")


def _notes(block: Block) -> Iterator[str]:
    wide = (2.0 * block.half_chord(block.upper), 2.0 * block.half_chord(block.lower))
    notes = (
        f"Each facet is {wide[0]:.1f} wide at the upper edge, {wide[1]:.1f} at the lower; both follow from the above.",
        f"Polished clear: upper face, lower face, facets. The faces parallel within {WEDGE_MM:.2f} over the round.",
        "The round is fine-turned, and painted matt black once the block fits. Edges broken 0.2 at most.",
        "No alcohol, acetone or toluene: acrylic crazes, most where machining left stress: anneal as its maker says.",
        "Why these tolerances: the round clears the housing's seat; the height moves the plane in focus, by a third of",
        "its error; a facet that leans off turns its light (its sleeve lies there) as much: calibration takes it up.",
    )
    for number, note in enumerate(notes):
        yield _text(40, 630 + 22 * number, note)


def _dimension(start: tuple[float, float], end: tuple[float, float], off: float, words: str) -> Iterator[str]:
    """A level dimension, `off` pixels below the points it measures between."""
    at = start[1] + off
    tail = 6.0 if off > 0 else -6.0
    yield f'<path d="M{start[0]:.1f} {start[1]} V{at + tail:.1f} M{end[0]:.1f} {end[1]} V{at + tail:.1f}" {THIN}/>'
    yield _arrow((start[0], at), (end[0], at))
    yield _text((start[0] + end[0]) / 2, at - 5, words, 'text-anchor="middle"')


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    tips = 'marker-start="url(#tip)" marker-end="url(#tip)"'
    return f'<path d="M{start[0]:.1f} {start[1]:.1f} L{end[0]:.1f} {end[1]:.1f}" {THIN} {tips}/>'


def _along(azimuth_deg: float, length: float) -> tuple[float, float]:
    angle = math.radians(azimuth_deg)
    return length * math.cos(angle), length * math.sin(angle)


def _text(x: float, y: float, text: str, style: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}"{" " + style if style else ""}>{escape(text)}</text>'


def _parameter(name: str) -> float:
    (value,) = _list(name)
    return value


def _list(name: str) -> tuple[float, ...]:
    found = re.search(rf"^{name} = \[?([-\d., ]+)\]?;", SOURCE.read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise ValueError(f"{SOURCE.name} has no parameter {name}")
    return tuple(float(word) for word in found[1].split(","))
