"""The gallery: surfaces by name, with the depth to which each is pressed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hal.twin.surfaces import Block, Coin, Groove, Plane, Sinusoid, Sphere, SphereGrid, Step, Surface, Texture


@dataclass(frozen=True, slots=True)
class Exhibit:
    """A surface of the gallery and how deep (mm) it is pressed."""

    surface: Surface
    indentation_mm: float


_GALLERY: Mapping[str, Callable[[], Exhibit]] = {
    "sphere": lambda: Exhibit(Sphere(3.0), 1.2),
    "sphere-grid": lambda: Exhibit(SphereGrid(1.0, 2.5, 2), 0.45),
    "plane": lambda: Exhibit(Plane(Block(3.0, 2.5), 0.05, 0.03), 0.6),
    "sinusoid": lambda: Exhibit(Sinusoid(Block(5.0, 3.5), 1.5, 0.06), 0.45),
    "groove": lambda: Exhibit(Groove(Block(4.5, 3.5), 0.8, 0.2, 0.12), 0.5),
    "step": lambda: Exhibit(Step(Block(4.5, 3.5), 0.1, 0.15), 0.5),
    "coin": lambda: Exhibit(Coin(5.0, 0.18, 0.18), 0.5),
    "texture": lambda: Exhibit(Texture(Block(4.5, 3.5), 0.012, 0.5, 0.15), 0.45),
}


def gallery_names() -> tuple[str, ...]:
    """Names of the exhibits."""
    return tuple(_GALLERY)


def exhibit(name: str) -> Exhibit:
    """The exhibit of that name.

    Raises
    ------
    KeyError
        There is none.
    """
    return _GALLERY[name]()
