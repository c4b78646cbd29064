"""A circuit board as data: parts with pads, tracks, vias, holes and an outline.

Lengths in mm; x to the right, y up, seen from the side of the parts. Copper is on the layers "top" and "bottom".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

Layer = Literal["top", "bottom"]
LAYERS: Final[tuple[Layer, Layer]] = ("top", "bottom")
Point = tuple[float, float]
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Pad:
    """A pad at its place on the board.

    name : number of the pin
    size : width and height; a round pad has both alike
    drill : diameter of the plated hole; 0: copper on top alone
    net : what it is on; "" when nothing is connected
    """

    name: str
    at: Point
    size: Point
    drill: float
    net: str
    is_round: bool = False

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Layers that have its copper."""
        return LAYERS if self.drill else ("top",)


@dataclass(frozen=True, slots=True)
class Part:
    """A part: its designator, value, package, what a person or machine places, and the room that it takes."""

    name: str
    value: str
    package: str
    at: Point
    pads: tuple[Pad, ...]
    courtyard: Box


@dataclass(frozen=True, slots=True)
class Track:
    """A straight piece of copper with round ends."""

    net: str
    layer: Layer
    start: Point
    end: Point
    width: float


@dataclass(frozen=True, slots=True)
class Via:
    """A plated hole from layer to layer."""

    net: str
    at: Point
    size: float = 0.7
    drill: float = 0.3


@dataclass(frozen=True, slots=True)
class Hole:
    """A hole without copper."""

    at: Point
    drill: float


@dataclass(frozen=True, slots=True)
class Board:
    """A whole board; the outline is a rectangle from the origin to `size`."""

    name: str
    size: Point
    parts: tuple[Part, ...]
    holes: tuple[Hole, ...]
    vias: tuple[Via, ...] = ()
    tracks: tuple[Track, ...] = ()

    def pads(self) -> Iterator[tuple[str, Pad]]:
        """Every pad with the name of its part."""
        for part in self.parts:
            for pad in part.pads:
                yield part.name, pad

    def nets(self) -> dict[str, set[tuple[str, str]]]:
        """Part and pin of every pad of a net, by the net's name."""
        found: dict[str, set[tuple[str, str]]] = {}
        for part, pad in self.pads():
            if pad.net:
                found.setdefault(pad.net, set()).add((part, pad.name))
        return found
