"""Reliefs that repeat themselves: presses of a ruler or a grating agree as well one period further.

Loops cannot tell, as places that are wrong by whole periods agree with each other. A press shows it by its own slopes:
they agree with themselves at a distance, and less on the way there (along an edge or a groove they agree all the way).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates

from host_sync.mosaic.overlaps import APART_PX, COARSE_PX, coarse_slopes
from host_sync.mosaic.presses import Small
from host_sync.registration.poses import reduced

ALIKE: Final = 0.6
"""Correlation of slopes with themselves at a distance from which they repeat."""

BETWEEN: Final = 0.5
"""Share of it below which the correlation must fall on the way."""

MIN_OVERLAP: Final = 0.3
"""Least part of a press that is compared with itself."""


def period_px(press: Small) -> float | None:
    """The shortest distance at which a press looks like itself, px of the press; None where none does."""
    step = max(1, -(-max(press.z_um.shape) // COARSE_PX))
    slopes = coarse_slopes(reduced(press.z_um, step))
    rows, columns = slopes.shape
    shape = (fft.next_fast_len(2 * rows), fft.next_fast_len(2 * columns))
    known = (slopes != 0.0).astype(np.float32)
    power = np.abs(slopes) ** 2
    agreement = fft.ifft2(np.abs(fft.fft2(slopes, shape)) ** 2).real
    # The power of both pieces where they overlap.
    covers = fft.ifft2(np.conj(fft.fft2(power, shape)) * fft.fft2(known, shape)).real
    covers = 0.5 * (covers + np.roll(covers[::-1, ::-1], 1, (0, 1)))
    overlap = fft.ifft2(np.abs(fft.fft2(known, shape)) ** 2).real
    enough = overlap >= MIN_OVERLAP * float(known.sum())
    correlation = fft.fftshift(np.where(enough, agreement / np.maximum(covers, 1e-9), 0.0))
    middle = np.array([size // 2 for size in shape])
    row, column = np.meshgrid(*(np.arange(size) - at for size, at in zip(shape, middle, strict=True)), indexing="ij")
    distance = np.hypot(row, column)
    alike = np.argwhere((correlation > ALIKE) & (distance > APART_PX))
    for at in sorted(alike, key=lambda one: float(distance[tuple(one)])):
        way = middle[:, None] + np.linspace(0.0, 1.0, 33) * (at - middle)[:, None]
        if float(map_coordinates(correlation, way, order=1).min()) < BETWEEN * correlation[tuple(at)]:
            return float(distance[tuple(at)] * step * press.step)
    return None


def repeats_px(presses: list[Small]) -> float | None:
    """The shortest period of a mosaic's presses, px; None where fewer than half of them repeat."""
    found = [period for period in map(period_px, presses) if period is not None]
    return min(found) if 2 * len(found) >= len(presses) and found else None
