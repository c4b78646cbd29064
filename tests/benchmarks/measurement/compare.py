"""Our numbers beside those of surfalize and Gwyddion on synthetic surfaces, as a Markdown table.

usage: python -m tests.benchmarks.measurement.compare

Columns of programs that are not installed are empty; both are GPL and are only called.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from host_sync.filters.form import PolynomialForm
from host_sync.iso25178.areal_parameters import (
    FUNCTIONAL,
    Autocorrelation,
    decay,
    functional_parameters,
    height_parameters,
    hybrid_parameters,
)
from tests.benchmarks.measurement.gwyddion_oracle import Gwyddion
from tests.benchmarks.measurement.surfaces import PITCH_UM, FloatArray, surfaces, torn

HEIGHTS: Final = ("Sa", "Sq", "Sp", "Sv", "Sz", "Ssk", "Sku", "Sdq", "Sdr", "Sal", "Str")
FUNCTIONS: Final = tuple(FUNCTIONAL)
HEAD: Final = ("surface", "parameter", "ours", "surfalize", "difference", "Gwyddion", "difference")


def ours(z_um: FloatArray) -> dict[str, float]:
    """Every areal parameter of a surface about its own mean."""
    z = z_um.astype(np.float32)
    fallen = decay(Autocorrelation(np.isfinite(z)).of(z))
    return (
        height_parameters(z)
        | hybrid_parameters(z, PITCH_UM)
        | functional_parameters(z)
        | {"Sal": fallen.shortest_px * PITCH_UM, "Str": fallen.shortest_px / fallen.longest_px}
    )


def by_surfalize(z_um: FloatArray) -> dict[str, float]:
    """The same by surfalize; empty when it is not installed."""
    try:
        from surfalize import Surface
    except ImportError:
        return {}
    surface = Surface(z_um - z_um.mean(), PITCH_UM, PITCH_UM)
    return {name: float(getattr(surface, name)()) for name in (*HEIGHTS, *FUNCTIONS)}


def by_gwyddion(z_um: FloatArray) -> dict[str, float]:
    """The same by Gwyddion, with masks; empty when it is not installed."""
    try:
        return Gwyddion().heights(z_um, PITCH_UM)
    except OSError:
        return {}


def rows() -> Iterator[tuple[str, str, float, float | None, float | None]]:
    """Surface, parameter, ours, surfalize's, Gwyddion's."""
    for name, z_um in surfaces().items():
        plane = PolynomialForm(np.ones(z_um.shape, np.bool_), 1).remove(z_um.astype(np.float32)).astype(np.float64)
        yield from _beside(name, ours(plane), by_surfalize(plane), by_gwyddion(plane))
        hole = torn(plane)
        # Under a mask Gwyddion's area holds parts of the cells beside it: there is no like to compare.
        masked = {one: value for one, value in by_gwyddion(hole).items() if one != "Sdr"}
        yield from _beside(f"{name}, masked", ours(hole), {}, masked)


def _beside(
    name: str, own: Mapping[str, float], first: Mapping[str, float], second: Mapping[str, float]
) -> Iterator[tuple[str, str, float, float | None, float | None]]:
    for parameter, value in own.items():
        if parameter in first or parameter in second:
            yield name, parameter, value, first.get(parameter), second.get(parameter)


def main() -> int:
    """Print the table; returns the exit code."""
    say = sys.stdout.write
    say("| " + " | ".join(HEAD) + " |\n|" + len(HEAD) * "---|" + "\n")
    for name, parameter, value, first, second in rows():
        cells = [name, parameter, f"{value:.5g}"]
        for other in (first, second):
            cells += ["", ""] if other is None else [f"{other:.5g}", _difference(value, other)]
        say("| " + " | ".join(cells) + " |\n")
    return 0


def _difference(own: float, other: float) -> str:
    if not (np.isfinite(own) and np.isfinite(other)):
        return "-"
    if abs(other) < 1e-3:
        return f"{own - other:+.1g}"
    return f"{100.0 * (own / other - 1.0):+.2f} %"


if __name__ == "__main__":
    sys.exit(main())
