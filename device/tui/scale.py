"""Round numbers for scales: steps of 1, 2 or 5 times a power of ten, and the words for a length."""

from __future__ import annotations

import math


def round_step(span: float, most: int) -> float:
    """The smallest step of 1, 2 or 5 times a power of ten that divides `span` into at most `most` parts."""
    least = span / max(most, 1)
    power = 10.0 ** math.floor(math.log10(least))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1.0 - 1e-9))


def round_down(limit: float) -> float:
    """The largest of 1, 2 or 5 times a power of ten that is no more than `limit`."""
    power = 10.0 ** math.floor(math.log10(limit) + 1e-9)
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= limit * (1.0 + 1e-9))


def ticks(lowest: float, highest: float, most: int) -> list[float]:
    """Multiples of a round step from lowest to highest, at most `most` + 1 of them."""
    step = round_step(highest - lowest, most)
    first, last = math.ceil(lowest / step - 1e-9), math.floor(highest / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def height_text(z_um: float) -> str:
    """A height as a scale shows it, without unit: tenths below 10 µm, else whole ones."""
    text = f"{z_um:.1f}" if abs(z_um) < 9.95 and z_um != round(z_um) else f"{z_um:.0f}"
    return "0" if text in {"-0", "-0.0"} else text


def length_text(length_um: float) -> str:
    """A length on the skin in the unit that suits it, such as "2 mm" or "500 µm"."""
    return f"{length_um / 1e3:g} mm" if length_um >= 1e3 else f"{length_um:g} µm"
