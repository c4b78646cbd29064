"""Specimens by name, with their indentation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hal.simulator.surfaces import (
    Block,
    Coin,
    Groove,
    Pebbles,
    Plane,
    Sinusoid,
    Sphere,
    SphereGrid,
    Step,
    Surface,
    Texture,
)


@dataclass(frozen=True, slots=True)
class Specimen:
    """A surface and its indentation (mm)."""

    surface: Surface
    indentation_mm: float


_GALLERY: Mapping[str, Callable[[], Specimen]] = {
    "sphere": lambda: Specimen(Sphere(3.0), 1.2),
    "sphere-grid": lambda: Specimen(SphereGrid(1.0, 2.5, 2), 0.45),
    "plane": lambda: Specimen(Plane(Block(3.0, 2.5), 0.05, 0.03), 0.6),
    "sinusoid": lambda: Specimen(Sinusoid(Block(5.0, 3.5), 1.5, 0.06), 0.45),
    "groove": lambda: Specimen(Groove(Block(4.5, 3.5), 0.8, 0.2, 0.12), 0.5),
    "step": lambda: Specimen(Step(Block(4.5, 3.5), 0.1, 0.15), 0.5),
    "coin": lambda: Specimen(Coin(5.0, 0.18, 0.18), 0.5),
    "pebbles": lambda: Specimen(Pebbles(0.9, 2.8, 11), 0.4),
    "texture": lambda: Specimen(Texture(Block(4.5, 3.5), 0.012, 0.5, 0.15), 0.45),
}


def gallery_names() -> tuple[str, ...]:
    """Names of the specimens."""
    return tuple(_GALLERY)


def specimen(name: str) -> Specimen:
    """The specimen of that name.

    Raises
    ------
    KeyError
        Unknown name.
    """
    return _GALLERY[name]()
