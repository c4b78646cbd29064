"""The marks: limits of each figure, and the record of what was reached."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

Figures: TypeAlias = Mapping[str, float]
"""Measured figures by name; unmeasured ones are missing."""

SKINS: Final = ("diffuse", "flake", "sharp-flake")
BANDS_DEG: Final = ((0, 10), (10, 20), (20, 30), (30, 40))
TILTS: Final = ("0-5", "5-10", "10-20", "20-30")
"""Bands of tilt on rendered sets, degrees, as their judge names them."""

BUILT: Final = ("pi5-imx296", "pi4-imx477-binned", "zero2w-imx708")
"""Shipped boards measured as built; pi4-imx477 has the lens and field of the binned one, and takes minutes."""

_REAL: Final = {
    "oem-bga": (1.15, 0.9, 1.84, 1.35),
    "taxim-small": (2.4, 1.95, 3.09, 2.29),
    "finger": (3.05, 2.9, 3.91, 3.69),
}
"""Limits of `surface` and `surface_smooth2`, degrees, and what the peer network reaches."""

_RENDERED: Final = {"finger": (2.2, 0.006), "series2": (0.9, 0.004), "matt": (6.0, 0.03), "tactile": (3.0, 0.01)}
"""Limits of heights, µm rms, and of features."""

_TWIN_DEG: Final = {"diffuse": 1.0, "flake": 1.2, "sharp-flake": 2.0}


@dataclass(frozen=True, slots=True)
class Mark:
    """A figure, its limits, and the peer's value, if known."""

    name: str
    unit: str
    most: float | None = None
    least: float | None = None
    peer: float | None = None

    def met(self, value: float | None) -> bool:
        """Whether a value is within the limits; an unmeasured one is not."""
        if value is None:
            return False
        return (self.most is None or value <= self.most) and (self.least is None or value >= self.least)

    @property
    def bound(self) -> float | list[float] | None:
        """The limit, or both of them, as in the record."""
        if self.most is not None and self.least is not None:
            return [self.least, self.most]
        return self.most if self.least is None else self.least

    @property
    def words(self) -> str:
        """The limit as text."""
        if self.most is not None and self.least is not None:
            return f"{self.least:g} to {self.most:g}"
        return f"<= {self.most:g}" if self.least is None else f">= {self.least:g}"


def all_marks() -> tuple[Mark, ...]:
    """Every mark, in the order of the table."""
    return (
        *_real_marks(),
        *_rendered_marks(),
        *_twin_marks(),
        *_resolution_marks(),
        *_built_marks(),
        *_coverage_marks(),
        *_certificate_marks(),
    )


def record(figures: Figures) -> dict[str, dict[str, dict[str, object]]]:
    """Contents of `accuracy.json`: value (null when not measured), mark and whether it is met, by name."""
    return {
        "marks": {
            mark.name: {
                "value": figures.get(mark.name),
                "mark": mark.bound,
                "met": mark.met(figures.get(mark.name)),
                "unit": mark.unit,
            }
            for mark in all_marks()
        }
    }


def _real_marks() -> Iterator[Mark]:
    for name, (surface, smooth, peer, peer_smooth) in _REAL.items():
        yield Mark(f"{name} surface", "deg", most=surface, peer=peer)
        yield Mark(f"{name} surface_smooth2", "deg", most=smooth, peer=peer_smooth)
        yield from _common_marks(name)


def _rendered_marks() -> Iterator[Mark]:
    for name, (heights_um, features) in _RENDERED.items():
        yield Mark(f"rendered {name} heights, rms", "um", most=heights_um)
        yield Mark(f"rendered {name} features off by", "", most=features)
        yield Mark(f"rendered {name} untouched skin, rms", "um", most=0.7)
        yield Mark(f"rendered {name} heights within sigma", "", most=0.85, least=0.55)
        yield Mark(f"rendered {name} height errors over sigma", "", most=1.3, least=0.75)
        yield Mark(f"rendered {name} slopes within sigma", "", most=0.80, least=0.58)
        for tilt in TILTS:
            yield Mark(f"rendered {name} slopes within sigma, {tilt} deg", "", most=0.80, least=0.58)
        yield Mark(f"rendered {name} wave of 80 px off by", "", most=0.02)
        yield Mark(f"rendered {name} presses that teach", "", least=0.95)


def _twin_marks() -> Iterator[Mark]:
    for skin, most in _TWIN_DEG.items():
        yield Mark(f"twin {skin} surface", "deg", most=most)
        yield from _common_marks(f"twin {skin}", 0.007)
        yield Mark(f"twin {skin} untouched skin, rms", "um", most=0.7)


def _common_marks(name: str, radius: float = 0.02) -> Iterator[Mark]:
    yield Mark(f"{name} radius off by", "", most=radius)
    yield Mark(f"{name} masked", "", most=0.03)


def _resolution_marks() -> Iterator[Mark]:
    yield Mark("three channels: ridge of 1 px, width", "px", most=2.0)
    yield Mark("three channels: sinusoid of 4 px keeps", "", least=0.5)
    yield Mark("Bayer: ridge of 1 px, width", "px", most=3.5)
    yield Mark("Bayer: sinusoid of 8 px keeps", "", least=0.5)


def _built_marks() -> Iterator[Mark]:
    """What the boards resolve with the lenses and lights that they would be built with."""
    for name in BUILT:
        yield Mark(f"{name}: ridge of 1 px, width", "px", most=3.5)
        yield Mark(f"{name}: sinusoid of 8 px keeps", "", least=0.5)


def _coverage_marks() -> Iterator[Mark]:
    for quantity in ("slope", "height"):
        for low, high in BANDS_DEG:
            yield Mark(f"twin {quantity} within sigma, {low}-{high} deg", "", most=0.76, least=0.60)


def _certificate_marks() -> Iterator[Mark]:
    """What certified specimens have to say of the twin."""
    yield Mark("certificate: worst |E_n|", "", most=1.0)
    yield Mark("certificate: amplification in z", "", most=1.02, least=0.98)
    yield Mark("certificate: amplification in x", "", most=1.005, least=0.995)
    yield Mark("certificate: amplification in y", "", most=1.005, least=0.995)
    yield Mark("certificate: noise", "um", most=0.7)
